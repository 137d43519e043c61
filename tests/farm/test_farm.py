# SPDX-License-Identifier: Apache-2.0
"""The examples for farms: the batch script, and what runs it under Open Job Description, Slurm and Flamenco."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture
def frames(data, tmp_path) -> Path:
    """Six rendered frames, in render/."""
    folder = tmp_path / "render"
    folder.mkdir()
    for number in range(1, 7):
        shutil.copy(data / "45_none.exr", folder / f"shot_{number:04d}.exr")
    return folder


@pytest.fixture(scope="session")
def environment(build) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str((build / "wheel" / "site").resolve())}


@pytest.fixture
def batch(root, frames, environment):
    def run(*options: str, source: str = "shot_####.exr") -> subprocess.CompletedProcess[str]:
        patterns = [str(frames / source), str(frames.parent / "clean" / "shot_####.exr")]
        command = [sys.executable, str(root / "samples" / "batch.py"), *patterns, *options]
        return subprocess.run(command, capture_output=True, text=True, env=environment)

    return run


def results(frames: Path) -> list[str]:
    return sorted(path.name for path in (frames.parent / "clean").iterdir())


def test_batch_gives_the_tools_files(batch, frames, quell, tmp_path):
    done = batch("--frames", "1-2,5")
    assert done.returncode == 0, done.stderr
    assert results(frames) == ["shot_0001.exr", "shot_0002.exr", "shot_0005.exr"]
    quell.ok("denoise", frames / "shot_0001.exr", "-o", tmp_path / "tool.exr", "--quiet")
    assert (tmp_path / "tool.exr").read_bytes() == (tmp_path / "clean" / "shot_0001.exr").read_bytes()


def test_batch_goes_on_where_it_stopped(batch, frames, tmp_path):
    assert batch("--frames", "1-2").returncode == 0
    before = (tmp_path / "clean" / "shot_0002.exr").stat().st_mtime_ns
    done = batch("--frames", "1-3")
    assert done.returncode == 0 and done.stdout.count("finished before") == 2
    assert (tmp_path / "clean" / "shot_0002.exr").stat().st_mtime_ns == before
    time.sleep(0.02)
    (frames / "shot_0002.exr").touch()  # rendered anew
    assert batch("--frames", "1-3").stdout.count("finished before") == 2


def test_batch_reports_what_failed(batch, frames):
    (frames / "shot_0002.exr").write_text("no picture")
    done = batch("--frames", "1-3")
    assert done.returncode == 1 and "frame 2:" in done.stderr
    assert results(frames) == ["shot_0001.exr", "shot_0003.exr"]
    assert batch("--frames", "one").returncode == 2
    assert batch("--frames", "1-2", source="shot.exr").returncode == 2


def test_batch_takes_a_quality(batch, frames, quell, tmp_path, root):
    for level in ("fast", "balanced", "high"):
        done = batch("--frames", "1", "--quality", level)
        if (root / "weights" / f"quell-{level}.qwt").exists():
            assert done.returncode == 0, done.stderr
            quell.ok("denoise", frames / "shot_0001.exr", "-o", tmp_path / "tool.exr", "-q", "--quality", level)
            result = tmp_path / "clean" / "shot_0001.exr"
            assert result.read_bytes() == (tmp_path / "tool.exr").read_bytes()
            result.unlink()
        else:
            assert done.returncode == 2 and f"quell-{level}.qwt" in done.stderr
    for options, said in ((["--quality", "best"], "fast, balanced, high"), (["--model", "dgan-kpn"], "one of them")):
        done = batch("--frames", "1", "--quality", "high", *options)
        assert done.returncode == 2 and said in done.stderr and "Traceback" not in done.stderr


def test_open_job_description(root, frames, environment, tmp_path):
    openjd = Path(sys.executable).parent / "openjd"
    assert openjd.exists(), "openjd-cli is not installed: scripts/requirements-farm.txt"
    template = root / "samples" / "openjd.yaml"
    subprocess.run([openjd, "check", template], check=True, capture_output=True)
    parameters = {"InDir": frames, "OutDir": tmp_path / "clean", "Frames": "1-6", "Python": sys.executable}
    command = [openjd, "run", template, "--step", "Denoise"]
    for name, value in parameters.items():
        command += ["-p", f"{name}={value}"]
    for count in ("", "finished before"):
        done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr
        assert results(frames) == [f"shot_{number:04d}.exr" for number in range(1, 7)]
        assert not count or done.stdout.count(count) == 6


def test_flamenco_job_type(root, tmp_path):
    """In a JavaScript engine, with the Manager's functions as their documentation has them."""
    node = shutil.which("node") or shutil.which("nodejs")
    if not node:
        pytest.skip("node is not installed")
    harness = """
    const tasks = [];
    const author = {
        Command: (name, parameters) => ({name, parameters}),
        Task: (name, type) => ({name, type, commands: [], addCommand(c) { this.commands.push(c); }}),
    };
    const frameChunker = (frames, size) => ["1-5", "6"];
    """
    job = {
        "settings": {
            "frames": "1-6",
            "chunk_size": 5,
            "quality": "HIGH",
            "passes": "ALL",
            "keep_noisy": True,
            "blendfile": "/a b.blend",
            "render_output_path": "/out/f_####",
            "format": "OPEN_EXR_MULTILAYER",
        }
    }
    script = tmp_path / "job.js"
    source = (root / "samples" / "farm" / "flamenco_quell.js").read_text()
    call = f"const job = {json.dumps(job)}; job.addTask = t => tasks.push(t); compileJob(job);"
    script.write_text(f"{harness}\n{source}\n{call}\nconsole.log(JSON.stringify({{tasks, type: JOB_TYPE}}));")
    output = json.loads(subprocess.run([node, script], capture_output=True, text=True, check=True).stdout)
    assert [task["name"] for task in output["tasks"]] == ["render-1-5", "render-6"]
    command = output["tasks"][0]["commands"][0]
    assert command["name"] == "blender-render" and command["parameters"]["blendfile"] == "/a b.blend"
    arguments = command["parameters"]["args"]
    assert arguments[-2:] == ["--render-frame", "1..5"]
    expression = arguments[arguments.index("--python-expr") + 1]
    compile(expression, "expression", "exec")
    assert "q.keep_noisy = True" in expression and "q.quality = 'HIGH'" in expression
    assert {setting["type"] for setting in output["type"]["settings"]} <= {"string", "int32", "float", "bool"}


# ---- Slurm ---------------------------------------------------------------------------------------------------------

SLURM_CONF = """\
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={control_port}
SlurmdPort={node_port}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
ProctrackType=proctrack/pgid
TaskPlugin=task/none
SelectType=select/cons_tres
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
MailProg=/bin/true
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} State=UNKNOWN
PartitionName=all Nodes={host} Default=YES State=UP
"""


def free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


@pytest.fixture
def slurm(tmp_path_factory) -> Iterator[dict[str, str]]:
    """A cluster of this machine alone, with its own configuration and keys; yields what sbatch's environment needs."""
    if os.geteuid() != 0 or not all(map(shutil.which, ("munged", "slurmctld", "slurmd", "sbatch"))):
        pytest.skip("Slurm is not installed, or this is not root")
    folder = Path("/tmp") / f"quell-slurm-{os.getpid()}"  # short: a socket's path has 108 bytes at most
    for name in ("", "state", "spool"):
        (folder / name).mkdir(mode=0o755)
    host = socket.gethostname().split(".")[0]
    control_port, node_port = free_ports(2)
    (folder / "slurm.conf").write_text(
        SLURM_CONF.format(host=host, control_port=control_port, node_port=node_port, folder=folder, cpus=os.cpu_count())
    )
    (folder / "munge.key").write_bytes(os.urandom(64))
    (folder / "munge.key").chmod(0o400)
    environment = {**os.environ, "SLURM_CONF": str(folder / "slurm.conf")}
    ends = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    munge = [f"--{name}={folder}/munge.{end}" for name, end in ends.items()]
    daemons = []
    try:
        daemons.append(subprocess.Popen(["munged", "--foreground", "--force", *munge], stderr=subprocess.DEVNULL))
        wait_for(lambda: (folder / "munge.socket").exists(), "munged")
        daemons.append(subprocess.Popen(["slurmctld", "-D", "-c"], env=environment, stderr=subprocess.DEVNULL))
        daemons.append(subprocess.Popen(["slurmd", "-D", "-N", host], env=environment, stderr=subprocess.DEVNULL))
        wait_for(lambda: "idle" in sinfo(environment), "a node that is idle")
        yield environment
    finally:
        for daemon in reversed(daemons):
            daemon.terminate()
            daemon.wait()
        shutil.rmtree(folder)


def sinfo(environment: dict[str, str]) -> str:
    return subprocess.run(["sinfo", "-h", "-o", "%t"], env=environment, capture_output=True, text=True).stdout


def wait_for(condition, what: str) -> None:
    end = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < end, f"waited in vain for {what}"
        time.sleep(0.2)


def test_slurm_array(root, frames, environment, slurm, tmp_path):
    (frames / "shot_0003.exr").write_text("no picture")
    command = ["sbatch", "--wait", "--array=1-4%2", "--cpus-per-task=1", f"--output={tmp_path}/%a.log"]
    command += [str(root / "samples" / "farm" / "slurm_array.sh")]
    command += [str(frames / "shot_####.exr"), str(tmp_path / "clean" / "shot_####.exr")]
    variables = {**slurm, **environment, "SLURM_CONF": slurm["SLURM_CONF"], "PYTHON": sys.executable}
    done = subprocess.run(command, env=variables, cwd=root, capture_output=True, text=True, timeout=300)
    assert done.returncode != 0, "a frame failed, and the array did not say so"
    assert results(frames) == ["shot_0001.exr", "shot_0002.exr", "shot_0004.exr"], done.stderr
    assert "frame 3:" in (tmp_path / "3.log").read_text()
    shutil.copy(frames / "shot_0001.exr", frames / "shot_0003.exr")
    done = subprocess.run(command, env=variables, cwd=root, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "finished before" in (tmp_path / "1.log").read_text()
    assert len(results(frames)) == 4
