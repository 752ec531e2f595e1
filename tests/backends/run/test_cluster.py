"""A dask cluster makes what one process makes, whoever of it is killed."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest
from dask_processes import DaskProcesses, dask_processes
from test_executors import bytes_of, tiny_cfg
from third_party import install, plan_fault

from scenec.backends.run import cluster, hands
from scenec.backends.run.limits import Limits
from scenec.backends.run.render import render
from scenec.backends.run.units import OfBackend
from scenec.cli.main import main
from scenec.compiler.compile import compile_cfg
from scenec.testing.processes import until, until_gone
from scenec.testing.small import write_cfg

pytestmark = pytest.mark.slow
FRAMES = "batch_*/frames/plain/*/0*.json"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cluster")
    compile_cfg(write_cfg(folder, tiny_cfg()), seed=1, out=folder / "out", faults="redraw")
    return folder


@pytest.fixture
def out(original: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Its renderer is of a third party, here and on workers."""
    install(tmp_path, monkeypatch)
    return shutil.copytree(original / "out", tmp_path / "out")


@pytest.fixture
def dask(out: Path, tmp_path: Path) -> Iterator[DaskProcesses]:
    with dask_processes(tmp_path / "dask") as made:
        yield made


def scenec(*words: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "scenec.cli.main", *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def refused(dask: DaskProcesses, out: Path, *words: object) -> str:
    """The one line that a render ends with, before any work."""
    before = bytes_of(out)
    done = scenec("render", out, "--backend", "plain", "--cluster", dask.file, *words)
    assert (done.returncode, done.stdout) == (2, "")
    assert bytes_of(out) == before
    (line,) = done.stderr.splitlines()
    return line


def test_stages_frames_scans_and_datasets_are_those_of_one_process(
    dask, original, out, tmp_path, monkeypatch
):
    # Paths as users give them: relative to a folder that the workers are not in.
    monkeypatch.chdir(tmp_path)
    dask.add()
    dask.add("--nthreads", "2")
    shutil.copy(original / "small.json", "cfg.json")
    assert main(["compile", "cfg.json", "--seed", "1", "-o", "alone", "--faults", "redraw"]) == 0
    monkeypatch.setenv("SCENEC_WORKERS", "0")
    assert main(["render", "alone", "--backend", "plain"]) == 0
    assert main(["scan", "alone"]) == 0
    assert main(["export", "alone", "--format", "coco", "-o", "alone.coco", "--workers", "1"]) == 0
    at = ["--cluster", str(dask.file)]
    words = ["compile", "cfg.json", "--seed", "1", "-o", "shared", "--faults", "redraw", *at]
    assert main(words) == 0
    assert main(["render", "shared", "--backend", "plain", *at]) == 0
    assert main(["scan", "shared", *at]) == 0
    assert main(["export", "shared", "--format", "coco", "-o", "shared.coco", *at]) == 0
    names = ".json", "timings.json"
    assert bytes_of(Path("alone"), *names) == bytes_of(Path("shared"), *names)
    # The card names the folder that was exported.
    datasets = [bytes_of(Path(name), "README.md", "SHA256SUMS", "export.json", "frames.csv")
                for name in ("alone.coco", "shared.coco")]  # fmt: skip
    assert datasets[0] == datasets[1]
    assert not dask.units()


def test_a_worker_of_another_version_is_refused(dask, out, tmp_path):
    info = tmp_path / "other" / "scenec-0.0.1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: scenec\nVersion: 0.0.1\n")
    path = os.pathsep.join([str(info.parent), os.environ["PYTHONPATH"]])
    dask.add(PYTHONPATH=path)
    line = refused(dask, out)
    assert "has scenec 0.0.1 instead of" in line
    assert line.endswith("install the same on every machine")


def test_a_worker_without_the_renderer_is_refused_where_one_is_needed(dask, out, tmp_path):
    dask.add(PYTHONPATH="")
    assert "has third-party (none) instead of 1.0: install" in refused(dask, out)
    done = scenec("render", out, "--passes", "depth", "--cluster", dask.file)
    assert done.returncode == 0, done.stderr


def test_a_worker_without_scenec_is_refused(dask, out, tmp_path):
    (tmp_path / "hidden" / "scenec").mkdir(parents=True)
    (tmp_path / "hidden" / "scenec" / "__init__.py").write_text("")
    dask.add(PYTHONPATH=str(tmp_path / "hidden"))
    line = refused(dask, out)
    assert "has not this scenec" in line
    assert "No module named 'scenec.backends'" in line


def test_a_worker_that_does_not_see_the_folder_is_refused(dask, out, tmp_path):
    # A machine of its own, as far as files go: there another disk lies over the folder.
    hide = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c",
            f"mount -t tmpfs none '{out}/batch_0000' && exec \"$@\"", "sh"]  # fmt: skip
    if subprocess.run([*hide, "true"], check=False, capture_output=True).returncode:
        pytest.skip("no namespaces here")
    dask.add(prefix=hide)
    line = refused(dask, out)
    assert f"does not see {out}/batch_0000: all machines need the same folder" in line
    # Where it is to be made, the folder around it counts.
    new = out / "batch_0000" / "new" / "out"
    made = scenec("compile", out / "cfg.json", "--seed", 1, "-o", new, "--cluster", dask.file)
    assert made.returncode == 2
    assert "does not see" in made.stderr


def test_without_a_worker_that_has_a_gpu_none_is_asked_of_them(dask, out):
    dask.add()
    assert "no worker has a GPU to give; start some with: dask worker" in refused(
        dask, out, "--device", "optix"
    )


def test_work_for_gpus_goes_to_workers_that_have_one(dask, out):
    dask.add()
    dask.add("--resources", "GPU=1")
    with cluster.Cluster(str(dask.file)) as executor:
        executor.prepare(out, "optix")
        assert executor.room(9)[1] == 1
        executor.prepare(out)
        assert executor.room(9)[1] == 2


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://127.0.0.1:9", "no scheduler with a worker answers"),
        ("nonsense", "no scheduler with a worker answers"),
        ("broken.json", "no scheduler with a worker answers"),
        ("empty.json", "no scheduler with a worker answers"),
    ],
)
def test_where_no_scheduler_answers_one_line_says_so(out, tmp_path, monkeypatch, address, words):
    monkeypatch.chdir(tmp_path)
    Path("broken.json").write_text("{")
    Path("empty.json").write_text("{}")
    done = scenec("render", out, "--backend", "plain", "--cluster", address)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"--cluster {address}: {words}" in line


def test_a_dask_worker_killed_amid_a_frame_costs_nothing_but_time(dask, out, tmp_path, monkeypatch):
    plan_fault(tmp_path, monkeypatch, "sleep", sample=1, times=1)
    dask.add()
    dask.add()
    lines: list[str] = []

    def kill(done: int, _total: int, _text: str) -> None:
        # All that can be made is made: what sleeps is one of these.
        if done == 8:
            (unit,) = [process for process in dask.units() if _claims(process)]
            next(w for w in dask.workers if w.pid == unit.ppid()).kill()
            until_gone(unit.pid)

    with cluster.Cluster(str(dask.file)) as executor:
        report = render(out, "plain", executor=executor, progress=kill, warn=lines.append)
    assert (report.rendered, report.failed) == (9, [])
    assert not list(out.rglob(".scenec-*"))


def _claims(process: psutil.Process) -> bool:
    return any(".scenec-lock-" in file.path for file in process.open_files())


def test_a_client_that_is_killed_leaves_frames_that_are_whole_and_workers_for_others(
    dask, out, tmp_path, monkeypatch
):
    plan_fault(tmp_path, monkeypatch, "work", amount=0.3)
    dask.add()
    dask.add()
    at = ["--backend", "plain", "--cluster", str(dask.file)]
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(out), *at]
    client = subprocess.Popen(command)
    until(lambda: len(list(out.glob(FRAMES))) > 1, client)
    client.kill()
    client.wait()
    done = scenec("render", out, *at, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["rendered"] + told["skipped"] == 9
    assert told["skipped"] >= 2
    assert not list(out.rglob(".scenec-*"))
    # The one that came ended what the other had left.
    assert not dask.units()
    monkeypatch.delenv("SCENEC_TEST_FAULT")
    render(out, "plain", folder=tmp_path / "calm")
    for batch in ("batch_0000", "batch_0001", "batch_0002"):
        calm = bytes_of(tmp_path / "calm" / batch, ".json")
        assert bytes_of(out / batch / "frames", ".json") == {
            name.removeprefix("frames/"): digest for name, digest in calm.items()
        }


def test_ctrl_c_ends_what_is_under_way_on_all_machines(dask, out, tmp_path, monkeypatch):
    plan_fault(tmp_path, monkeypatch, "sleep", sample=1)
    dask.add()
    dask.add()
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(out), "--backend", "plain",
               "--cluster", str(dask.file)]  # fmt: skip
    client = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until(lambda: len(list(out.rglob(".scenec-lock-000001"))) == 2, client)
    units = dask.units()
    client.send_signal(signal.SIGINT)
    told = client.communicate()[1]
    assert client.returncode == 130, told
    assert "Traceback" not in told
    for unit in units:
        until_gone(unit.pid)
    assert not list(out.rglob(".scenec-*"))
    # They are there for the next one.
    monkeypatch.delenv("SCENEC_TEST_FAULT")
    assert scenec("scan", out, "--cluster", dask.file).returncode == 0


def test_a_scheduler_that_goes_ends_the_command_in_one_line(dask, out, tmp_path, monkeypatch):
    plan_fault(tmp_path, monkeypatch, "work", amount=0.3)
    dask.add()
    command = [sys.executable, "-m", "scenec.cli.main", "render", str(out), "--backend", "plain",
               "--cluster", str(dask.file)]  # fmt: skip
    client = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until(lambda: bool(list(out.glob(FRAMES))), client)
    dask.scheduler.kill()
    told = client.communicate()[1]
    assert client.returncode == 2, told
    assert "Traceback" not in told
    assert "what has been made stays: run again" in told.splitlines()[-1]


def test_processes_of_a_dask_worker_end_when_nobody_asks_any_more(monkeypatch):
    monkeypatch.setattr(hands, "IDLE_S", 0.5)
    unit = OfBackend("1", exec)
    before = psutil.Process().children()
    assert hands.work(unit, Limits(), "somebody", 1, 1).error is None
    (process,) = [child for child in psutil.Process().children() if child not in before]
    until_gone(process.pid)
    assert not hands._idle


def test_a_local_cluster_listens_to_this_machine_alone():
    with cluster.Cluster("local", 1):
        places = [c.laddr.ip for c in psutil.Process().net_connections("inet") if not c.raddr]
    assert places
    assert set(places) == {"127.0.0.1"}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificate")
def test_over_tls_frames_are_made_and_who_has_no_key_is_refused(out, tmp_path, monkeypatch):
    # The files and variables of docs/cluster.md.
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj",
         "/CN=scenec", "-keyout", "key.pem", "-out", "cert.pem"],
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    said = {"COMM__DEFAULT_SCHEME": "tls", "COMM__REQUIRE_ENCRYPTION": "true"}
    said["COMM__TLS__CA_FILE"] = str(tmp_path / "cert.pem")
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        said[f"COMM__TLS__{role}__CERT"] = str(tmp_path / "cert.pem")
        said[f"COMM__TLS__{role}__KEY"] = str(tmp_path / "key.pem")
    with monkeypatch.context() as keys:
        for name, value in said.items():
            keys.setenv(f"DASK_DISTRIBUTED__{name}", value)
        with dask_processes(tmp_path / "tls", 1) as dask:
            address = json.loads(dask.file.read_text())["address"]
            assert address.startswith("tls://")
            done = scenec("render", out, "--backend", "plain", "--cluster", address)
            assert done.returncode == 0, done.stderr
            keys.undo()
            before = bytes_of(out)
            for given in (address, address.replace("tls://", "tcp://")):
                done = scenec("render", out, "--backend", "plain", "--cluster", given)
                assert done.returncode == 2
                (line,) = done.stderr.splitlines()
                assert f"--cluster {given}" in line
            assert bytes_of(out) == before
