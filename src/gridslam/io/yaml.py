"""YAML 1.1, as ROS reads it."""

from __future__ import annotations

import warnings
from typing import Any

__all__ = ["YamlError", "parse_yaml"]


class YamlError(ValueError):
    """A text is no YAML; `line` is where, from 1, or None."""

    def __init__(self, problem: str, line: int | None) -> None:
        """State what is wrong, and where."""
        super().__init__(problem)
        self.line = line


def parse_yaml(text: str, *, as_nodes: bool = False) -> Any:  # noqa: ANN401
    """Numbers, texts, lists and dicts of a text; or nodes (of `ruamel.yaml.nodes`), which know what stands where.

    Raises YamlError.
    """
    from ruamel.yaml import YAML  # slow to import
    from ruamel.yaml.error import MarkedYAMLError, YAMLError
    from ruamel.yaml.scanner import ScannerError

    reader = YAML(typ="safe", pure=True)
    reader.version = (1, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of 1e-3, which YAML 1.1 would have as 1.0e-3
        try:
            return reader.compose(text) if as_nodes else reader.load(text)
        except MarkedYAMLError as error:
            begun = error.context_mark if isinstance(error, ScannerError) else None  # where what is not ended begins
            mark = begun or error.problem_mark
            raise YamlError(error.problem, mark.line + 1) from None
        except YAMLError as error:
            raise YamlError(" ".join(str(error).split()), None) from None
