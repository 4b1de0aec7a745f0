"""Whatever a parser comes across is one error, which names the file and, where it is known, the line."""

from __future__ import annotations

import pytest

from gridslam.config import Configuration, load, override
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.maps import read_map_description
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.text import parse_json, read_json, refuse_unreadable
from support.fuzz_values import HOSTILE


@pytest.mark.parametrize(
    ("value", "line"),
    [
        ("0x_", 3),
        ("2001-99-99", 3),
        ('!!int ""', 3),
        ('!!bool "abc"', 3),
        ('"\\U00110000"', None),
        ("9" * 5000, 3),
        (f"0x{'f' * 5000}", None),
        ("1:" * 3000 + "1", None),
        ('"\\uD800"', None),
        ("[" * 3000, None),
    ],
)
def test_values_that_yaml_cannot_make(tmp_path, value, line):
    (tmp_path / "a.yaml").write_text(f"amcl:\n  ros__parameters:\n    alpha1: {value}\n    alpha2: 0.1\n")
    with pytest.raises(InputError, match=r"a\.yaml.*: expected 'name: value' in YAML, got: ") as caught:
        read_parameter_file(tmp_path / "a.yaml")
    assert caught.value.line == line


@pytest.mark.parametrize("text", ["? [1]\n: 2\n", "mode: {a: b}\n", "mode: [[1]]\n", f"mode: {'[' * 90}{']' * 90}\n"])
def test_a_map_has_no_lists_in_lists(tmp_path, text):
    (tmp_path / "map.yaml").write_text(f"image: a.pgm\n{text}")
    with pytest.raises(InputError, match=r"map\.yaml, line 2: expected a text, a number or a list"):
        read_map_description(tmp_path / "map.yaml")


@pytest.mark.parametrize(
    "value", ["9" * 5000, f"0x{'f' * 5000}", "[" * 3000, "[" * 150 + "]" * 150, "{a = " * 200 + "1" + "}" * 200]
)
def test_values_that_toml_cannot_make(tmp_path, value):
    (tmp_path / "a.toml").write_text(f"particles = {value}\n")
    with pytest.raises(ConfigurationError, match=r"a\.toml: expected TOML: "):
        load(tmp_path / "a.toml")
    with pytest.raises(ConfigurationError, match=r"^particles: "):
        override(Configuration(), f"particles={value}")


def test_a_key_of_thousands_of_parts_is_refused_before_it_is_parsed(tmp_path):
    """The time and the memory of parsers grow with the square of the parts: 50,000 take 30 s and 10 GB."""
    key = ".".join("a" * 50_000)
    (tmp_path / "a.toml").write_text(f"{key} = 1\n")
    with pytest.raises(ConfigurationError, match=r"a\.toml: expected TOML with at most 100 dots in a line"):
        load(tmp_path / "a.toml")
    with pytest.raises(ConfigurationError, match="expected name=value"):
        override(Configuration(), f"{key}=1")


@pytest.mark.parametrize("value", HOSTILE)
def test_an_assignment_is_taken_or_refused_in_one_line(value):
    message = ""
    try:
        override(Configuration(), f"particles={value}")
    except ConfigurationError as error:
        message = str(error)
    assert len(message.splitlines()) <= 1


@pytest.mark.parametrize("text", ["[" * 5000, '{"a": ' * 150 + "1" + "}" * 150, f'{{"a": {"9" * 400}}}'])
def test_json_that_no_program_can_go_on_with(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=r"a\.json: expected JSON, got: "):
        read_json(tmp_path / "a.json")


def test_halves_of_characters_are_read_where_files_of_odd_names_are_listed(tmp_path):
    (tmp_path / "a.json").write_text('{"log": "\\udcff"}')
    assert read_json(tmp_path / "a.json") == {"log": "\udcff"}
    with pytest.raises(ArgumentError, match="texts of whole characters"):
        parse_json('{"log": "\\udcff"}')


@pytest.mark.parametrize("error", [RecursionError(), MemoryError(), OverflowError("too\nlarge"), AttributeError()])
def test_errors_of_any_type_name_the_file(error):
    with (
        pytest.raises(InputError, match=r"^file: expected a thing, got: [^\n]+$"),
        refuse_unreadable("file", "a thing"),
    ):
        raise error
