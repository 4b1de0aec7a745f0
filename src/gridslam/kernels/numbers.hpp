// Numbers in text.
#pragma once

#include <cstddef>
#include <vector>

namespace gridslam {

// Appends the numbers of `rows` lines, separated by blanks, to `out`. False where a word is no plain decimal number of
// at most 32 characters and an exponent of at most two digits, or where a line has not as many words as the first.
bool parse_numbers(const char* text, size_t size, size_t rows, std::vector<double>& out);

}  // namespace gridslam
