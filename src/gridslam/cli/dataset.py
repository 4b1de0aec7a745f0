"""gridslam dataset."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from gridslam.cli.output import print_json
from gridslam.errors import ArgumentError
from gridslam.io.datasets import DATASETS, fetch_dataset, find_dataset

__all__ = ["DATASETS_SCHEMA", "get_dataset", "list_datasets"]

DATASETS_SCHEMA = "gridslam.datasets/1"


def list_datasets(as_json: bool) -> None:
    """List the available datasets."""
    if as_json:
        print_json({"schema": DATASETS_SCHEMA, "datasets": [asdict(dataset) for dataset in DATASETS]})
        return
    for dataset in DATASETS:
        click.echo(f"{dataset.name:10} {dataset.size / 1e6:.1f} MB  {dataset.about}")
        click.echo(f"{'':10} {dataset.credit}\n{'':10} {dataset.licence}")


def get_dataset(name: str, out: Path, url: str | None, as_json: bool) -> None:
    """Download a dataset, and print its credit."""
    try:
        dataset = find_dataset(name)
    except ArgumentError as error:
        raise click.ClickException(str(error).replace("name", "NAME", 1)) from None
    if out.exists() and not out.is_dir():
        raise click.ClickException(f"{out}: expected a folder to write to, got a file")
    file = fetch_dataset(name, out, url=url)
    if as_json:
        print_json({"schema": DATASETS_SCHEMA, "datasets": [asdict(dataset)], "path": str(file)})
    else:
        click.echo(f"{file}: {dataset.about}\ncredit: {dataset.credit}\nlicence: {dataset.licence}")
