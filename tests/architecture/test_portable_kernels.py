"""The kernels are standard C++20; what a compiler has beyond it stands in one file, behind a test for that compiler."""

import re

import pytest

from support.house import PACKAGE, ROOT

KERNELS = sorted(file for file in (PACKAGE / "kernels").iterdir() if file.suffix in (".cpp", ".hpp"))
EXTENSION = re.compile(
    r"__builtin|__attribute__|__restrict|__int128|__declspec|#pragma (?!once)|\bM_[A-Z]|\btypeof\b|\?:"
)
GUARD = re.compile(r"#if.*\bdefined\((__GNUC__|__clang__|_MSC_VER|__GLIBC__)")


def code(text):
    """The text without its comments."""
    return re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)


def unguarded(text):
    """Lines with an extension that stand outside an #if that asks for a compiler, or in its #else."""
    depth, found = [], []
    for line in code(text).splitlines():
        if line.startswith("#if"):
            depth.append(bool(GUARD.match(line)))
        elif line.startswith(("#else", "#elif")):
            depth[-1] = False
        elif line.startswith("#endif"):
            depth.pop()
        elif EXTENSION.search(line) and not any(depth):
            found.append(line.strip())
    return found


@pytest.mark.parametrize("file", KERNELS, ids=lambda file: file.name)
def test_extensions_are_behind_a_test_for_the_compiler(file):
    text = file.read_text(encoding="utf-8")
    assert unguarded(text) == []
    assert file.name == "maps.hpp" or not EXTENSION.search(code(text)), "extensions stand in maps.hpp"


def test_what_has_no_guard_is_found():
    guarded = "#if defined(__GNUC__)\n__builtin_trap();\n#else\n{}\n#endif\n"
    assert unguarded(guarded.format("return;")) == []
    assert unguarded(guarded.format("__assume(0); __builtin_trap();")) == ["__assume(0); __builtin_trap();"]
    assert unguarded("double turn = 2 * M_PI;") == ["double turn = 2 * M_PI;"]


def test_the_language_is_the_standard_one():
    text = (ROOT / "CMakeLists.txt").read_text(encoding="utf-8")
    assert "set(CMAKE_CXX_EXTENSIONS OFF)" in text
