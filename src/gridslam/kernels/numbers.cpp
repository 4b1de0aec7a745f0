// Decimal numbers of many lines of the same form, as a log has them and results get them: rounded as every correct
// program rounds them.

#include "numbers.hpp"

#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>

namespace gridslam {
namespace {

constexpr std::ptrdiff_t kLongest = 32;  // characters of a word
constexpr std::array<double, 23> kPowers = {1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,  1e8,  1e9,  1e10, 1e11,
                                            1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22};
constexpr uint64_t kExact = uint64_t{1} << 53;  // whole numbers below are doubles

bool is_digit(char c) { return c >= '0' && c <= '9'; }

// A word from `at` on; its end, or nullptr where it is no plain number.
const char* parse_word(const char* at, const char* end, double& value) {
  const char* const begin = at;
  const bool negative = at < end && *at == '-';
  at += negative;
  uint64_t digits = 0;
  int count = 0, after_point = 0, exponent = 0;
  for (; at < end && is_digit(*at); ++at, ++count) digits = 10 * digits + static_cast<uint64_t>(*at - '0');
  if (at < end && *at == '.')
    for (++at; at < end && is_digit(*at); ++at, ++count, ++after_point)
      digits = 10 * digits + static_cast<uint64_t>(*at - '0');
  if (!count) return nullptr;
  if (at < end && (*at == 'e' || *at == 'E')) {
    ++at;
    const bool down = at < end && *at == '-';
    at += at < end && (*at == '-' || *at == '+');
    const char* const first = at;
    for (; at < end && is_digit(*at) && at - first < 3; ++at) exponent = 10 * exponent + (*at - '0');
    if (at == first || at - first > 2) return nullptr;
    if (down) exponent = -exponent;
  }
  if (at - begin > kLongest) return nullptr;
  const int power = exponent - after_point;
  if (count <= 19 && digits < kExact && power >= -22 && power <= 22) {  // both exact: one rounding (Clinger 1990)
    const double whole = static_cast<double>(digits);
    const double size = power < 0 ? whole / kPowers[-power] : whole * kPowers[power];
    value = negative ? -size : size;
    return at;
  }
#if defined(__cpp_lib_to_chars) && __cpp_lib_to_chars >= 201611L
  const auto parsed = std::from_chars(begin, at, value);
  return parsed.ec == std::errc{} && parsed.ptr == at ? at : nullptr;
#else
  return nullptr;  // the caller has another parser
#endif
}

constexpr uint64_t kSecond = 1'000'000'000;  // ns
constexpr size_t kLongestWord = 330;         // 309 digits before the point, nine after it

char* format_stamp(char* at, int64_t stamp_ns) {
  uint64_t size = static_cast<uint64_t>(stamp_ns);
  if (stamp_ns < 0) {
    *at++ = '-';
    size = -size;
  }
  at = std::to_chars(at, at + kLongestWord, size / kSecond).ptr;
  *at = '.';
  size %= kSecond;
  for (char* digit = at + 9; digit > at; --digit, size /= 10) *digit = static_cast<char>('0' + size % 10);
  return at + 10;
}

char* format_number(char* at, double value, bool is_fixed) {
  if (std::isnan(value)) value = NAN;  // its sign is not written
#if defined(__cpp_lib_to_chars) && __cpp_lib_to_chars >= 201611L
  const auto format = is_fixed ? std::chars_format::fixed : std::chars_format::general;
  return std::to_chars(at, at + kLongestWord, value, format, 9).ptr;
#else
  char* const end = at + std::snprintf(at, kLongestWord, is_fixed ? "%.9f" : "%.9g", value);
  for (; at < end; ++at)
    if (*at == ',') *at = '.';  // of the locale
  return end;
#endif
}

}  // namespace

std::string format_rows(const int64_t* stamps_ns, const double* values, const bool* is_fixed, size_t rows,
                        size_t columns, char separator) {
  std::string text;
  text.reserve(rows * (columns + 2) * 12);
  std::array<char, kLongestWord> word;
  for (size_t row = 0; row < rows; ++row) {
    text.append(word.data(), format_stamp(word.data(), stamps_ns[row]));
    for (size_t column = 0; column < columns; ++column) {
      text += separator;
      text.append(word.data(), format_number(word.data(), values[row * columns + column], is_fixed[column]));
    }
    text += '\n';
  }
  return text;
}

bool parse_numbers(const char* text, size_t size, size_t rows, std::vector<double>& out) {
  const char* at = text;
  const char* const end = text + size;
  size_t columns = 0;
  out.reserve(size / 5);
  for (size_t row = 0; row < rows; ++row) {
    const size_t before = out.size();
    for (; at < end && *at != '\n'; ++at) {
      if (*at == ' ') continue;
      double value;
      at = parse_word(at, end, value);
      if (!at) return false;
      out.push_back(value);
      if (at == end || *at == '\n') break;
      if (*at != ' ') return false;
    }
    if (row == 0)
      columns = out.size();
    else if (out.size() - before != columns)
      return false;
    if ((at == end) != (row + 1 == rows)) return false;
    ++at;
  }
  return columns > 0;
}

}  // namespace gridslam
