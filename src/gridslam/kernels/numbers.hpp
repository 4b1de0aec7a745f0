// Numbers in text.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

namespace gridslam {

// Appends the numbers of `rows` lines, separated by blanks, to `out`. False where a word is no plain decimal number of
// at most 32 characters and an exponent of at most two digits, or where a line has not as many words as the first.
bool parse_numbers(const char* text, size_t size, size_t rows, std::vector<double>& out);

// A line of text for each row: its stamp in s with nine decimals, exact, and `columns` numbers, each after the
// separator, with nine decimals where its column is fixed, else with nine significant digits; as printf has them.
std::string format_rows(const int64_t* stamps_ns, const double* values, const bool* is_fixed, size_t rows,
                        size_t columns, char separator);

}  // namespace gridslam
