"""YAML 1.1, as ROS reads it."""

from __future__ import annotations

import warnings
from typing import Any

from gridslam.arguments import require_plain
from gridslam.errors import ArgumentError, describe_failure

_MOST_VALUES = 100_000


class YamlError(ValueError):
    """A text is no YAML; `line` is where, from 1, or None."""

    def __init__(self, problem: str, line: int | None) -> None:
        """State the fault and its position."""
        super().__init__(problem)
        self.line = line


def parse_yaml(text: str, *, as_nodes: bool = False) -> Any:  # noqa: ANN401
    """Parse YAML to numbers, texts, lists and dicts, or to nodes (of `ruamel.yaml.nodes`) with their positions.

    Keys of dicts are texts as they stand there, as in ROS: `y` is a coordinate, though the value `y` is true.

    Raises YamlError, whatever the parser comes across: also where a value is not of its kind (`0x_`, `2001-99-99`), and
    where values are nested too deeply, or refer to others so often that they would not fit.
    """
    from ruamel.yaml import YAML  # slow to import
    from ruamel.yaml.error import MarkedYAMLError
    from ruamel.yaml.scanner import ScannerError

    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of 1e-3, which YAML 1.1 would have as 1.0e-3
        try:
            root = reader.compose(text)
            _prepare_node(root, {})
            if as_nodes or root is None:
                return root
            tree = reader.constructor.construct_document(root)
            require_plain(tree)
            return tree
        except MarkedYAMLError as error:
            begun = error.context_mark if isinstance(error, ScannerError) else None  # where what is not ended begins
            mark = begun or error.problem_mark
            raise YamlError(error.problem, mark.line + 1) from None
        except (YamlError, ArgumentError, RecursionError) as error:
            raise YamlError(describe_failure(error), getattr(error, "line", None)) from None
        except Exception as error:
            raise YamlError(describe_failure(error), _find_line(reader)) from None


def _find_line(reader: Any) -> int | None:  # noqa: ANN401
    """Find the line, from 1, of the value that was made when an error was raised; None where it came before."""
    begun = list(reader.constructor.recursive_objects)  # values around it first
    return int(begun[-1].start_mark.line) + 1 if begun else None


def _prepare_node(node: Any, counts: dict[int, int]) -> int:  # noqa: ANN401
    """Tag the keys of all mappings in a node as texts, and return how many values it holds.

    Values that it refers to count, too; `counts` has those of other nodes, by their ids.
    """
    if node is None or node.id == "scalar":
        return 1
    if id(node) not in counts:
        counts[id(node)] = _MOST_VALUES + 1  # until it is known: a node that contains itself has no end
        below = node.value
        if node.id == "mapping":
            _tag_keys_as_texts(node)
            below = [part for pair in node.value for part in pair]
        counts[id(node)] = 1 + sum(_prepare_node(part, counts) for part in below)
    if counts[id(node)] > _MOST_VALUES:
        problem = f"expected at most {_MOST_VALUES} values, got more by references to others"
        raise YamlError(problem, node.start_mark.line + 1)
    return counts[id(node)]


def _tag_keys_as_texts(mapping: Any) -> None:  # noqa: ANN401
    for key, _ in mapping.value:
        if key.id == "scalar" and not key.tag.endswith(":merge"):
            key.tag = "tag:yaml.org,2002:str"
