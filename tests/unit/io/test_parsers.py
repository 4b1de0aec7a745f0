"""Whatever a parser comes across is one error, which names the file and, where it is known, the line."""

from __future__ import annotations

import pytest

from gridslam.api.amcl import override_configuration, read_amcl
from gridslam.config import Configuration, load, override
from gridslam.errors import ArgumentError, ConfigurationError, InputError
from gridslam.io.maps import read_map_description
from gridslam.io.ros_parameters import read_parameter_file
from gridslam.io.text import parse_json, read_json, refuse_unreadable
from gridslam.localization import MonteCarloConfiguration

_DIGITS = "9" * 5000
HOSTILE: tuple[str, ...] = (
    "0x_", "0x", "0b_", "0b", "0o", "0o8", "_", "+", "-", ".", "1_", "1__0", "+.inf", "-.inf", ".nan", "nan", "inf",
    "-inf", "1e400", "-1e400", "1e-400", _DIGITS, f"-{_DIGITS}", f"0x{'f' * 5000}", f"0b{'1' * 9000}", f"0.{_DIGITS}",
    f"1e{_DIGITS}", "1:" * 200 + "1", "1:" * 3000 + "1", "1:" * 3000 + "1.5", "190:20:30", "190:20:30.15", "08",
    "1,000", "1.2.3", "2001-99-99", "2001-01-01", "0000-01-01", "2001-01-01T99:99:99Z", "2001-01-01 00:00:00 +99:99",
    "07:32:61", "9999-12-31", '!!int ""', '!!int "x"', '!!bool "abc"', "!!float x", "!!timestamp x", "!!binary x",
    "!!null x", "!!set {x, y}", "!!omap [x]", "!!pairs 3", "!!str {a: b}", "!!int [1]", "!!map [1]",
    "!!python/object/apply:os.system [id]", "!<x y", "!foo bar", "!!merge x", '"\\U00110000"', '"\\uD800"', '"\\xZZ"',
    '"\\q"', "'", '"', '"""', "'''", "|", ">", "|99", "\u2028", "\ufeff", "\x7f", "ä" * 500, "a" * 100_000, "y", "on",
    "~", "null", "true", "=", "<<", "?", "- -", "&a", "*a", "&a *a", "%", "@", "`", "#", "---", "...", "[" * 90,
    "[" * 1000, "[" * 90 + "]" * 90, "[" * 150 + "]" * 150, "[" * 400 + "]" * 400, "{" * 1000,
    "{a: " * 200 + "1" + "}" * 200, "[[[]]]", "[]", "{}", "{a: 1}", "{a = 1}", "[1, 2, 3]",
    "[" + "1, " * 2000 + "1]", "&a [*a]", "{<<: 3}", "{? [1, 2] : 3}", "{? {a: b} : c}", "[1, [2, [3]]]",
    "{a = {b = {c = 1}}}", "[{}, {}]", "{kind = 3}", "{kind = [1]}", "{kind = 'none'}",
)  # fmt: skip

_KEYS: tuple[str, ...] = (
    "0x_", "2001-99-99", _DIGITS, "? [1, 2]\n", "<<", "&a b", "[a]", '""', '"\\U00110000"', "a.b.c", "a." * 90 + "a",
    "a." * 5000 + "a", "[" + "a." * 90 + "a]\nb", "[[a]]\nb", "[a]\nb", '"a\\nb"', "ros__parameters", "/**", "kind",
    "amcl", "a" * 100_000, "true", "~",
)  # fmt: skip

_AMCL = "amcl:\n  ros__parameters:\n    max_particles: 2000\n    initial_pose: {x: 1.0, y: 2.0, yaw: 0.5}\n"
_MAP = "image: map.pgm\norigin: [-1.0, -2.0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"


def _write(path, name, text):
    (path / name).write_text(text, encoding="utf-8", errors="surrogatepass")
    return path / name


READERS = {
    "map.yaml": lambda path, name, value: read_map_description(_write(path, "map.yaml", f"{_MAP}{name}: {value}\n")),
    "amcl.yaml": lambda path, name, value: read_amcl(_write(path, "a.yaml", f"{_AMCL}    {name}: {value}\n")),
    "nodes.yaml": lambda path, name, value: read_parameter_file(_write(path, "a.yaml", f"{name}: {value}\n{_AMCL}")),
    "run.toml": lambda path, name, value: load(
        _write(path, "run.toml", f"{name} = {value}\n[tracker]\nmap_scans = 3\n")
    ),
    "--set": lambda path, name, value: override(Configuration(), f"{name}={value}"),
    "--set of localize": lambda path, name, value: override_configuration(
        MonteCarloConfiguration(), [f"{name}={value}"]
    ),
}
NAMES = {"map.yaml": "resolution", "amcl.yaml": "alpha1", "nodes.yaml": "a", "--set of localize": "alpha1", "-p": "a"}


@pytest.mark.parametrize("reader", READERS)
def test_whatever_stands_for_a_value_or_a_name_is_taken_or_refused_in_one_line(tmp_path, reader):
    own = NAMES.get(reader, "particles")
    for name, value in [*((own, value) for value in HOSTILE), *((key, "1") for key in _KEYS)]:
        message = ""
        try:
            READERS[reader](tmp_path, name, value)
        except (InputError, ConfigurationError) as error:
            message = str(error)
        assert len(message.splitlines()) <= 1, (name, value)


@pytest.mark.parametrize(
    "text",
    [
        "a0: &a0 [x, x]\n" + "".join(f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]\n" for k in range(1, 40)),
        "c0: &c0 {x: 1}\n" + "".join(f"c{k}: &c{k} {{p: *c{k - 1}, q: *c{k - 1}}}\n" for k in range(1, 40)),
    ],
)
def test_yaml_whose_every_line_doubles_the_one_before_is_refused(tmp_path, text):
    with pytest.raises(InputError, match=r"a\.yaml"):
        read_parameter_file(_write(tmp_path, "a.yaml", text))


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
        ("[" * 1000, None),
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
