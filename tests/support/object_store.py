"""An object store with the interface of S3 on this machine: moto's server, in a process of its own."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from support.ports import free_port

SECRET = "not-to-be-seen-in-any-file"
PATIENCE_S = 60.0


@contextmanager
def object_store() -> Iterator[dict[str, str]]:
    """Start a server; gives the environment in which s3:// is that server, with a bucket named fleet."""
    port = free_port()
    command = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    environment = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": SECRET,
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        until = time.monotonic() + PATIENCE_S
        while True:
            assert time.monotonic() < until, "the server did not start"
            assert server.poll() is None, "the server ended"
            try:
                socket.create_connection(("127.0.0.1", port), timeout=1.0).close()
                break
            except OSError:
                time.sleep(0.1)
        yield environment
    finally:
        server.kill()
        server.wait()


def bucket(environment: dict[str, str]) -> Any:
    """A client of the server, by which tests look at what is there; it makes the bucket."""
    import boto3

    client = boto3.client(
        "s3",
        endpoint_url=environment["AWS_ENDPOINT_URL"],
        aws_access_key_id=environment["AWS_ACCESS_KEY_ID"],
        aws_secret_access_key=environment["AWS_SECRET_ACCESS_KEY"],
        region_name="us-east-1",
    )
    client.create_bucket(Bucket="fleet")
    return client


def names(client: Any, prefix: str) -> list[str]:
    """Keys in the bucket below a prefix."""
    found = client.list_objects_v2(Bucket="fleet", Prefix=prefix)
    return sorted(item["Key"].removeprefix(prefix) for item in found.get("Contents", ()))
