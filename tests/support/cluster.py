"""A real two-worker Ray cluster, started and stopped once for the tests of a module."""

from __future__ import annotations

import os
import secrets
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from made_once import made_once
from simple_rules import search_simply
from stated_clocks import clocks

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cyclekit.parallel.engine import Engine

TESTS = Path(__file__).parent


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Engine]:
    """The engine of a cluster of two workers, which runs in processes of its own."""
    if find_spec("ray") is None:
        pytest.skip("needs Ray: pip install 'cyclekit[ray]'")
    from cyclekit.parallel.engine import Engine

    with socket.socket() as free:
        free.bind(("", 0))
        port = free.getsockname()[1]
    paths = os.pathsep.join([str(TESTS), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": paths, "RAY_USAGE_STATS_ENABLED": "0"}
    environment |= {"POLARS_MAX_THREADS": "2", "OMP_NUM_THREADS": "2"}  # workers are to take one whatever stands there
    words = ["start", "--head", f"--port={port}", "--num-cpus=2", "--include-dashboard=false", "--block"]
    log = (tmp_path_factory.mktemp("ray") / "head.log").open("w+")
    head = subprocess.Popen(
        [sys.executable, "-m", "ray.scripts.scripts", *words],
        env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True,
    )  # fmt: skip
    try:
        _wait_for(head, Path(log.name))
        yield Engine("ray", address=f"127.0.0.1:{port}")
    finally:
        if "ray" in sys.modules:
            sys.modules["ray"].shutdown()
        os.killpg(head.pid, signal.SIGKILL)  # told to end, Ray's processes wait for each other
        head.wait()
        log.close()


def _wait_for(head: subprocess.Popen[bytes], log: Path) -> None:
    for _ in range(1800):  # three minutes: on a busy machine Ray takes one
        said = log.read_text(encoding="utf-8")
        if "Ray runtime started" in said:
            return
        try:
            head.wait(0.1)
        except subprocess.TimeoutExpired:
            continue
        break
    raise RuntimeError(said)


@pytest.fixture(scope="session")
def small_cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the logs of six executions in two sessions, their dataset, a model, and a sequence file."""
    from cyclekit.api.train import Training, train_at
    from cyclekit.dataset.dataset import Dataset
    from cyclekit.ingest.ingest import ingest
    from cyclekit.learning.networks.spec import ModelSpec
    from cyclekit_sim import simulate

    def make(folder: Path) -> None:
        for number in range(2):
            simulate("box-picking", folder / f"day_{number}", executions=3, seed=number)
            (folder / "logs").mkdir(exist_ok=True)
            (folder / f"day_{number}" / "session_000").rename(folder / "logs" / f"day_{number}")
        (folder / "day_0" / "cell.toml").rename(folder / "logs" / "cell.toml")
        with clocks():  # as commands in other processes do
            dataset = ingest([folder / "logs"], folder / "dataset").dataset
        with pytest.MonkeyPatch.context() as patch:
            search_simply(patch)
            train_at(Training(str(dataset), ModelSpec.of(epochs=2), str(folder / "model")))
        tasks = set(Dataset.open(dataset).tasks()["task"])
        slots = [f"{side}_{number}" for side in ("left", "right") for number in range(1, 6)]
        ways = [slot for slot in slots if {f"conveyor->{slot}", f"{slot}->conveyor"} <= tasks][:4]
        entries = [
            f'[[sequence]]\nname = "{slot}"\nplaces = ["home", "conveyor", "{slot}", "conveyor", "left_1"]'
            for slot in ways
        ]
        (folder / "sequences.toml").write_text("\n".join(entries), encoding="utf-8")

    return made_once(tmp_path_factory, "fleet_cell", make)


@pytest.fixture(scope="session")
def bucket(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a bucket on a real S3 server of this machine, which the environment points to."""
    if find_spec("moto") is None:
        pytest.skip("needs an S3 server: pip install 'moto[server]'")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    place, secret = f"http://127.0.0.1:{port}", secrets.token_hex(8)
    given = {"AWS_ACCESS_KEY_ID": secret, "AWS_SECRET_ACCESS_KEY": secret, "AWS_DEFAULT_REGION": "us-east-1"}
    given |= {"AWS_ENDPOINT_URL": place, "AWS_EC2_METADATA_DISABLED": "true"}
    words = [sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)]
    with (tmp_path_factory.mktemp("s3") / "server.log").open("w") as log, pytest.MonkeyPatch.context() as patch:
        for name, value in given.items():
            patch.setenv(name, value)
        patch.setenv("CYCLEKIT_CACHE", str(tmp_path_factory.mktemp("cache")))
        server = subprocess.Popen(words, stdout=log, stderr=log)
        try:
            _answers(port)
            urllib.request.urlopen(urllib.request.Request(f"{place}/plant", method="PUT")).close()
            yield "s3://plant"
        finally:
            server.kill()
            server.wait()


def _answers(port: int) -> None:
    for _ in range(300):
        try:
            socket.create_connection(("127.0.0.1", port)).close()
        except OSError:
            time.sleep(0.1)
        else:
            return
    raise TimeoutError(port)
