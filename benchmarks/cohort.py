"""What a cohort costs: surveys, jobs, assembly, one and two workers, Dask against local, memory by size.

Every specimen has the logs of ``paper-a-22``; but in ``paper`` the forces of one template are scaled, so that
generation costs next to nothing.  Five parts:

* ``workers``: the jobs of some specimens on one process and on two, in turn, and on Dask workers beside them.
  The ratio is of the wall time of the jobs alone; the whole command is told as well.
* ``memory``: peak resident memory of every process at two sizes of cohort.
* ``paper``: 17 specimens of 22 logs at 1 kHz, each a tissue of its own, from CSV to bundles and report and to
  the population with its bundle and report, with the breakdown, on two workers and on one.
* ``dask``: a large cohort in full on two workers of Dask and on one: the ratio of the wall time of the jobs,
  what of the workers' time is not spent in jobs, peak resident memory of every process, and whether the files
  of the first specimens are the bits that two local processes write.
* ``overhead``: tasks that compute nothing and return as many bytes as a specimen's file, on two local
  processes and on two workers of Dask: what handing out and taking back costs.  Wall time is an upper bound,
  whatever the machine does beside it; processor time is that of all processes, the scheduler's too.  The
  scheduler's peak memory after so many tasks is told with it (``--repeats 0``: after one round).

    python benchmarks/cohort.py [--part workers|memory|paper|dask|overhead] [--specimens 24] [--json]

Load of the machine is told with every figure: trust ratios of one run.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from harness import FINISHED, command_line, peak_MB, run

from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.population.coordinates import Coordinates
from tissueid.synth import DIALECTS, bluehill_csv, recipe, simulate
from tissueid.synth.recipe import Branch

#: Specimens of short logs: one branch.
SHORT = ("--draws", "400", "--branches", "1", "--stiffness-degree", "0", "--sampler")
PORT = 18_787
#: Environment of a scheduler and of workers that leave the processors to the jobs: docs/cohorts.md.
CALM = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "500ms",
}
SAMPLE_S = 0.2
#: Bytes of a job and of its result: 22 recordings by name, and a file of 22 short logs.
JOB_BYTES, RESULT_BYTES = 8_000, 670_000
#: Spread of ln of each quantity between specimens, and the correlation of any two.
BETWEEN, COMMON = 0.15, 0.9


def write_cohort(folder: Path, specimens: int, rate_Hz: float) -> int:
    """Every specimen is one template with its force scaled; returns the number of samples."""
    decimals = (5, 5, 5) if rate_Hz > 100.0 else (3, 5, 4)
    template = replace(recipe("paper-a-22"), rate_Hz=rate_Hz, decimals=decimals)
    logs = simulate(template, rng=np.random.default_rng(1))
    rng = np.random.default_rng(2)
    for number in range(specimens):
        scale, own = float(np.exp(rng.normal(0.0, 0.15))), folder / f"head-{number:05d}"
        own.mkdir(parents=True)
        for log in logs:
            one = replace(log, specimen=own.name, force_N=scale * log.force_N)
            (own / f"{log.name}.csv").write_bytes(
                bluehill_csv(one, dialect=DIALECTS["bare"], decimals=decimals)
            )
    return specimens * sum(log.time_s.size for log in logs)


def write_population(folder: Path, specimens: int) -> int:
    """Every specimen is a tissue of its own, drawn around that of paper A; returns the number of samples."""
    around = recipe("paper-a-22")
    places = Coordinates(kelvin_voigt(1, 0, 8.0))
    typical = np.array([*around.static, *around.branches[0].stiffness, around.branches[0].tau_s])
    centre = places.to_phi(typical)[0][0]
    rng, samples = np.random.default_rng(3), 0
    for number in range(specimens):
        theta = drawn_tissue(places, centre, rng)
        own = folder / f"head-{number:05d}"
        own.mkdir(parents=True)
        one = replace(
            around,
            specimen=own.name,
            static=tuple(map(float, theta[:3])),
            branches=(Branch((float(theta[3]),), float(theta[4])),),
        )
        for log in simulate(one, rng=rng):
            content = bluehill_csv(log, dialect=DIALECTS["bare"], decimals=one.decimals)
            (own / f"{log.name}.csv").write_bytes(content)
            samples += log.time_s.size
    return samples


def drawn_tissue(places: Coordinates, centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A passive tissue; its quantities scatter by :data:`BETWEEN`, correlated by :data:`COMMON`."""
    while True:
        scatter = np.sqrt(COMMON) * rng.standard_normal() + np.sqrt(1.0 - COMMON) * rng.standard_normal(
            places.size
        )
        theta = places.to_theta(centre + BETWEEN * scatter)
        if places.passive(theta)[0]:
            return np.asarray(theta[0])


@dataclass
class Memory:
    """Peak resident memory of a process and of those it started [MB]."""

    parent: float = 0.0
    children: dict[int, float] = field(default_factory=dict)

    def look(self, pid: int) -> None:
        with suppress(OSError, ValueError, IndexError):
            self.parent = max(self.parent, peak_MB(pid))
            # any thread may have started them
            for started in Path(f"/proc/{pid}/task").glob("*/children"):
                for child in map(int, started.read_text().split()):
                    self.children[child] = max(self.children.get(child, 0.0), peak_MB(child))


def fit(data: Path, out: Path, *args: str, where: Path | None = None) -> dict[str, Any]:
    """One whole ``tissueid fit`` in a process of its own, with what its index says of its stages."""
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-m", "tissueid", "fit", str(data), "-o", str(out), "-q", *args]
    memory, begin = Memory(), time.time()
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=where
    ) as process:
        done = threading.Event()

        def watch() -> None:
            while not done.wait(SAMPLE_S):
                memory.look(process.pid)

        thread = threading.Thread(target=watch)
        thread.start()
        _, errors = process.communicate()
        done.set()
        thread.join()
    wall = time.time() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if process.returncode not in FINISHED:
        sys.exit(errors)
    with sqlite3.connect(out / "index.sqlite") as index:
        started, ended = index.execute("SELECT started, ended FROM runs ORDER BY id DESC").fetchone()
        first, last, cpu, jobs = index.execute(
            "SELECT MIN(began), MAX(began + seconds), SUM(seconds), COUNT(*) FROM jobs"
            " WHERE began IS NOT NULL"
        ).fetchone()
    return {
        "wall_s": wall,
        "processor_s": sum(after[:2]) - sum(before[:2]),
        "start_s": started - begin,
        "survey_s": first - started,
        "jobs_s": last - first,
        "jobs_sum_s": cpu,
        "assembly_s": ended - last,
        "report_and_commit_s": begin + wall - ended,
        "jobs": jobs,
        "parent_MB": memory.parent,
        "worker_MB": max(memory.children.values(), default=0.0),
        "out_MB": sum(path.stat().st_size for path in out.rglob("*") if path.is_file()) / 2**20,
        "load": os.getloadavg()[0],
    }


def population(out: Path) -> dict[str, Any]:
    """``tissueid cohort`` of a finished fit, in a process of its own: population bundle and report."""
    wall, processor, _ = run("-m", "tissueid", "cohort", str(out), "-q")
    sampler = json.loads((out / "population.json").read_bytes())["population"]["sampler"]
    return {
        "wall_s": wall,
        "processor_s": processor,
        "converged": sampler["converged"],
        "sweeps": sampler["sweeps"],
        "load": os.getloadavg()[0],
    }


def paper_part(data: Path, out: Path, specimens: int, sampler: str, crews: list[int]) -> dict[str, object]:
    """From CSV to the population, stage by stage, and its whole wall time, with every number of workers."""
    samples, rows = write_population(data, specimens), []
    for workers in crews:
        fitted = fit(data, out, "--sampler", sampler, "--workers", str(workers))
        of_all = population(out)
        total = {key: fitted[key] + of_all[key] for key in ("wall_s", "processor_s")}
        rows.append({"workers": workers, "fit": fitted, "population": of_all, "total": total})
    result: dict[str, object] = {"samples": samples, "sampler": sampler, "runs": rows}
    if len(rows) == 2:
        result["jobs_ratio"] = rows[1]["fit"]["jobs_s"] / rows[0]["fit"]["jobs_s"]
    return result


def cluster(stack: ExitStack, workers: int) -> tuple[str, list[int]]:
    """A scheduler and some workers of one thread each, until the stack is closed: address and processes."""
    address = f"tcp://127.0.0.1:{PORT}"
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    dask = [sys.executable, "-m", "dask"]
    # a worker finds the task of this file
    paths = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    quiet["env"] = os.environ | {"PYTHONPATH": paths, **CALM}
    commands = [["scheduler", "--host", "127.0.0.1", "--port", str(PORT), "--no-dashboard"]]
    commands += [["worker", address, "--nthreads", "1", "--no-dashboard"]] * workers
    pids = []
    for command in commands:
        process = subprocess.Popen([*dask, *command], **quiet)
        stack.callback(process.wait)
        stack.callback(process.terminate)
        pids.append(process.pid)
        time.sleep(3.0)
    return address, pids


def workers_part(data: Path, out: Path, sampler: str, repeats: int) -> dict[str, object]:
    """One process against two, and two against two workers of Dask; medians of the ratios."""
    short = (*SHORT, sampler)
    rows: dict[str, list[dict[str, object]]] = {"one": [], "two": [], "dask": []}
    with ExitStack() as stack:
        address, _ = cluster(stack, 2)
        # the first task of a worker imports
        fit(data, out, *short, "--scheduler", address)
        for _ in range(repeats):
            rows["one"].append(fit(data, out, *short, "--workers", "1"))
            rows["two"].append(fit(data, out, *short, "--workers", "2"))
            rows["dask"].append(fit(data, out, *short, "--scheduler", address))

    def ratio(a: str, b: str) -> float:
        return float(np.median([x["jobs_s"] / y["jobs_s"] for x, y in zip(rows[a], rows[b], strict=True)]))

    return {"one_over_two": ratio("one", "two"), "dask_over_two": ratio("dask", "two"), "runs": rows}


def written(out: Path) -> dict[str, str]:
    """Hash of every specimen's file."""
    with sqlite3.connect(out / "index.sqlite") as index:
        return dict(
            index.execute("SELECT specimen, sha256 FROM jobs JOIN results USING (key) WHERE state = 'done'")
        )


def dask_part(
    folder: Path, specimens: int, rate_Hz: float, sampler: str, crews: list[int], compared: int
) -> dict[str, object]:
    """A large cohort on Dask; ``compared`` specimens also on two local processes, under the same paths."""
    short = (*SHORT, sampler)
    everything, some, data = folder / "all", folder / "some", Path("data")
    samples = write_cohort(everything / data, specimens, rate_Hz)
    for own in sorted((everything / data).iterdir())[:compared]:
        shutil.copytree(own, some / data / own.name)
    fit(data, some / "out", *short, "--workers", "2", where=some)
    local = written(some / "out")
    rows = []
    for workers in crews:
        with ExitStack() as stack:
            address, pids = cluster(stack, workers)
            run = fit(data, everything / "out", *short, "--scheduler", address, where=everything)
            memory = Memory()
            # workers may stand under nannies
            for pid in pids[1:]:
                memory.look(pid)
            largest = max(memory.parent, *memory.children.values())
            peaks = {"scheduler_MB": peak_MB(pids[0]), "dask_worker_MB": largest}
        files = written(everything / "out")
        rows.append(
            {
                "workers": workers,
                **run,
                **peaks,
                "not_in_jobs": 1.0 - run["jobs_sum_s"] / (workers * run["jobs_s"]),
                "specimens": len(files),
                "same_bits": sum(files.get(name) == sha for name, sha in local.items()),
                "compared": len(local),
            }
        )
        print(json.dumps(rows[-1]), file=sys.stderr, flush=True)
    result: dict[str, object] = {"samples": samples, "runs": rows}
    if len(rows) == 2:
        result["jobs_ratio"] = rows[1]["jobs_s"] / rows[0]["jobs_s"]
    return result


def processor_s(pid: int) -> float:
    """Processor time so far of a process and of those it started that still run."""
    ticks = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
    seconds = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        seconds += sum(processor_s(int(child)) for child in children.read_text().split())
    return seconds


def nothing(payload: bytes) -> bytes:
    """A task that is only handed out and taken back."""
    return payload[:1] * RESULT_BYTES


def overhead_part(tasks: int, repeats: int) -> dict[str, object]:
    """Time a task that computes nothing [ms], by two local processes and by two workers of Dask.

    Memory of the scheduler is that after ``repeats + 1`` rounds.
    """
    from tissueid.study.cluster import DaskWorkers
    from tissueid.study.tasks import LocalProcesses, Task

    found: dict[str, list[float]] = {
        f"{who}_{what}_ms": [] for who in ("local", "dask") for what in ("wall", "processor")
    }
    with ExitStack() as stack:
        address, pids = cluster(stack, 2)
        crews = {
            "local": stack.enter_context(LocalProcesses(2)),
            "dask": stack.enter_context(DaskWorkers(address)),
        }
        # the first round starts processes and imports
        for number in range(repeats + 1):
            for name, crew in crews.items():
                work = [Task(one, "cohort:nothing", bytes(JOB_BYTES)) for one in range(tasks)]
                begin, before = time.monotonic(), processor_s(os.getpid())
                done = sum(len(one.result or b"") == RESULT_BYTES for one in crew.run(work, lambda *_: None))
                if done != tasks:
                    sys.exit(f"{name}: {tasks - done} tasks have no result")
                if number:
                    wall, processor = time.monotonic() - begin, processor_s(os.getpid()) - before
                    found[f"{name}_wall_ms"].append(1e3 * wall / tasks)
                    found[f"{name}_processor_ms"].append(1e3 * processor / tasks)
        memory = peak_MB(pids[0])
    return {**found, "scheduler_MB": memory, "load": os.getloadavg()[0]}


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument(
        "--part", choices=["workers", "memory", "paper", "dask", "overhead"], default="workers"
    )
    parser.add_argument("--specimens", type=int, default=17)
    parser.add_argument("--times", type=float, default=5.0, help="second size of cohort in --part memory")
    parser.add_argument("--rate", type=float, default=10.0, help="sampling rate of short logs [Hz]")
    parser.add_argument("--sampler", choices=["emcee", "none"], default="emcee")
    parser.add_argument(
        "--crews", type=int, nargs="+", default=[2, 1], help="numbers of workers in --part dask and paper"
    )
    parser.add_argument("--compared", type=int, default=50, help="specimens that are also fitted locally")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if options.part == "overhead":
        print(json.dumps(overhead_part(options.specimens, options.repeats)))
        return
    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder) / "data", Path(folder) / "out"
        if options.part == "paper":
            result = paper_part(data, out, options.specimens, options.sampler, options.crews)
        elif options.part == "dask":
            result = dask_part(
                Path(folder),
                options.specimens,
                options.rate,
                options.sampler,
                options.crews,
                options.compared,
            )
        elif options.part == "workers":
            samples = write_cohort(data, options.specimens, options.rate)
            result = {"samples": samples, **workers_part(data, out, options.sampler, options.repeats)}
        else:
            sizes = (options.specimens, round(options.specimens * options.times))
            runs = []
            for size in sizes:
                shutil.rmtree(data, ignore_errors=True)
                write_cohort(data, size, options.rate)
                runs.append(fit(data, out, *SHORT, options.sampler, "--workers", "2"))
            result = {"sizes": sizes, "runs": runs}
    print(json.dumps(result, indent=2 if options.json else None))


if __name__ == "__main__":
    main()
