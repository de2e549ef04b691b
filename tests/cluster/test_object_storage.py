# SPDX-License-Identifier: Apache-2.0
"""A run whose files lie in a bucket, on an S3 server of this machine: ``uv run --group storage --group test pytest -m
slow tests/cluster/test_object_storage.py``."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
QUICK = [
    "depth={primitives: 0}",
    "background={training: {iterations: 200}}",
    "humans={iterations: 60, gaussians: 2000}",
]


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.skipif(
    find_spec("snakemake_storage_plugin_s3") is None or find_spec("moto") is None, reason="group storage"
)
def test_the_smallest_scene_is_made_in_a_bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    try:
        address = "http://{}:{}".format(*server.get_host_and_port())
        keys = {"aws_access_key_id": "key", "aws_secret_access_key": "secret", "region_name": "us-east-1"}
        bucket = boto3.client("s3", endpoint_url=address, **keys)
        bucket.create_bucket(Bucket="takes")
        storage = ["--default-storage-provider", "s3", "--default-storage-prefix", "s3://takes/first"]
        storage += ["--storage-s3-endpoint-url", address, "--shared-fs-usage", "persistence", "sources"]
        storage += ["source-cache", "software-deployment", "storage-local-copies"]
        monkeypatch.setenv("SNAKEMAKE_STORAGE_S3_ACCESS_KEY", "key")
        monkeypatch.setenv("SNAKEMAKE_STORAGE_S3_SECRET_KEY", "secret")

        def run(*options: str) -> str:
            command = [
                sys.executable,
                "-m",
                "snakemake",
                "look",
                "--snakefile",
                str(ROOT / "Snakefile"),
                "--cores",
                "2",
            ]
            config = ["--config", "dataset=resources/studio/tiny.yaml", *QUICK]
            done = subprocess.run(
                [*command, *options, *storage, *config],
                cwd=tmp_path,
                env={**os.environ, "PYTHONPATH": str(ROOT / "workflow")},
                text=True,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )
            assert done.returncode == 0, done.stdout[-5000:]
            return done.stdout

        run()
        pages = bucket.get_paginator("list_objects_v2").paginate(Bucket="takes")
        held = {one["Key"]: one["Size"] for page in pages for one in page["Contents"]}
        assert held["first/results/tiny/enhance/orbit.mp4"] > 1000
        assert not (tmp_path / "results/tiny/enhance").exists(), "results are in the bucket"
        assert "Nothing to be done" in run()
    finally:
        server.stop()
