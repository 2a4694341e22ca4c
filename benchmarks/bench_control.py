"""The control law beside KDL and quadratic programmes: time, pivot and tip. In simulation.

`--json FILE` writes (times in us, deviations as their names say):

    format          "surg_bench_control/1"
    machine         {processor, cores, load_before, load_after, date, compiler, seconds, cycles}
    cycle_us        {exact|velocity|limited|limited_preview|paper|qp_<name>|
                    kdl_<name>: {median, p99}}: one cycle, from joint positions to joint
                    velocities, UR5e
    rcm_deviation_um {<law>: {mean, max_at_samples, max_between}}
    tip_error_um    {<law>: {mean, max}}
    violations      {<law>: cycles over a joint's velocity or acceleration}
    failures        {<law>: cycles in which a solver reported no solution}
    what            {<law>: one line}
    panda           the same five for the Panda
    ratio           {<robot>: {exact, velocity: fastest C++ QP over the form, medians; qp:
                    its name; limited_eiquadprog: eiquadprog over 'limited'}}
    whole_cycle_us  {plain, tremor: {median, p99}}: a whole controller cycle, called back to back;
                    absent where the workspace is not built
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent / "control"))

import bench_scene
import control_page
import libraries
from machine import processor

from surg_cli.host import paths
from surg_cli.host.terminal import CliError, Progress, say, table, warn

SOURCE = Path(__file__).parent / "control"
BUILD = paths.BUILD / "bench_control"
PROGRAM = BUILD / "bench_control"
ROBOTS = ("ur5e", "panda")
FORMS = ("exact", "velocity")


def build(packages: Path | None) -> None:
    """Configure and compile the C++ program with whatever libraries there are."""
    configure = [
        "cmake",
        "-S",
        str(SOURCE),
        "-B",
        str(BUILD),
        "-DCMAKE_BUILD_TYPE=Release",
        f"-DBENCH_PREFIX={packages or ''}",
        f"-DBENCH_DEVEL={paths.DEVEL if (paths.DEVEL / 'setup.bash').exists() else ''}",
    ]
    make = ["cmake", "--build", str(BUILD), "--parallel", str(os.cpu_count() or 1)]
    for title, argv in (("configure", configure), ("compile", make)):
        libraries.run(argv, title)


def call(*words: str, title: str) -> dict[str, Any]:
    """Run the C++ program; its progress is shown, its JSON returned."""
    with Progress(title) as progress:
        process = subprocess.Popen(
            [str(PROGRAM), *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None and process.stdout is not None
        said = []
        for line in process.stderr:
            parts = line.split()
            if len(parts) == 3 and parts[0] == "progress":
                progress.update(int(parts[1]) / int(parts[2]))
            else:
                said.append(line)
        text = process.stdout.read()
        if process.wait() != 0:
            raise CliError(f"{PROGRAM.name} failed: {''.join(said).strip()}")
    result = json.loads(text)
    assert isinstance(result, dict)
    return result


def regroup(laws: dict[str, Any]) -> dict[str, Any]:
    """Figures by law to figures by kind, as the JSON has them."""
    deviation = {
        "mean": "rcm_mean_um",
        "max_at_samples": "rcm_max_at_samples_um",
        "max_between": "rcm_max_between_um",
    }
    return {
        "cycle_us": {n: {"median": law["median"], "p99": law["p99"]} for n, law in laws.items()},
        "rcm_deviation_um": {
            n: {key: law[old] for key, old in deviation.items() if old in law}
            for n, law in laws.items()
        },
        "tip_error_um": {
            n: {"mean": law["tip_mean_um"], "max": law["tip_max_um"]} for n, law in laws.items()
        },
        "violations": {n: law["violations"] for n, law in laws.items() if "violations" in law},
        "failures": {n: law["failures"] for n, law in laws.items()},
        "what": {n: law["what"] for n, law in laws.items()},
    }


def ratios(cycle_us: dict[str, Any]) -> dict[str, Any]:
    """How much faster our forms are than the fastest quadratic programme in the same program."""
    programmes = {n: c["median"] for n, c in cycle_us.items() if n.startswith("qp_")}
    if not programmes:
        return {}
    fastest = min(programmes, key=lambda name: programmes[name])
    return {
        "qp": fastest,
        **{f: programmes[fastest] / cycle_us[f]["median"] for f in FORMS},
        **(
            {"limited_eiquadprog": programmes["qp_eiquadprog"] / cycle_us["limited"]["median"]}
            if "qp_eiquadprog" in programmes
            else {}
        ),
    }


def binding(told: dict[str, Any]) -> dict[str, Any]:
    """Where the limits bind: how often, and times the QP with the same box (median, p99)."""
    laws = told["laws"]
    if "qp_eiquadprog" not in laws:
        return {}
    qp = laws["qp_eiquadprog"]
    return {
        "share": laws["limited"]["failures"] / told["cycles"],
        **{
            form: {key: laws[form][key] / qp[key] for key in ("median", "p99")}
            for form in ("limited", "limited_preview")
        },
    }


def whole_cycles(cell: Path) -> dict[str, dict[str, float]] | None:
    """Time of whole cycles [us], called back to back, without and with `tremor`."""
    if not (BUILD / "bench_cycle").exists():
        return None
    told = {}
    for name, tremor in (("plain", "0"), ("tremor", "10")):
        done = subprocess.run(
            [str(BUILD / "bench_cycle"), str(cell), tremor, "100000"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            warn(f"bench: whole cycles are left out: {done.stderr.strip()}")
            return None
        told[name] = {key: json.loads(done.stdout)[key] for key in ("median", "p99")}
    return told


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Everything, in the order of the JSON."""
    found = libraries.installed() if options.offline else libraries.install()
    if found is None:
        say("without the libraries of others: their columns are left out")
    build(found)
    load = os.getloadavg()
    compiler = subprocess.run(["c++", "--version"], capture_output=True, text=True, check=False)
    result: dict[str, Any] = {
        "format": "surg_bench_control/1",
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "load_before": [round(x, 2) for x in load],
            "date": datetime.date.today().isoformat(),
            "compiler": compiler.stdout.splitlines()[0] if compiler.stdout else "unknown",
            "seconds": options.seconds,
        },
    }
    per_robot: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for robot in ROBOTS:
            folder = Path(scratch) / robot
            arm = bench_scene.load_arm(paths.CELLS / f"sim_{robot}")
            bench_scene.write(arm, options.seconds, folder)
            files = (str(folder / "arm.txt"), str(folder / "tip.path"))
            told = call("laws", *files, title=robot)
            per_robot[robot] = regroup(told["laws"])
            bench_scene.write(arm, options.seconds, folder, bench_scene.BINDING)
            bound = call("laws", *files, title=f"{robot}, limits bind")
            per_robot[robot]["binding"] = binding(bound)
            result["machine"]["cycles"] = told["cycles"]
        result.update(per_robot["ur5e"])
        result["panda"] = per_robot["panda"]
        result["ratio"] = {robot: ratios(per_robot[robot]["cycle_us"]) for robot in ROBOTS}
        result["binding"] = {robot: per_robot[robot].pop("binding") for robot in ROBOTS}
    if (whole := whole_cycles(paths.CELLS / "sim_ur5e")) is not None:
        result["whole_cycle_us"] = whole
    result["machine"]["load_after"] = [round(x, 2) for x in os.getloadavg()]
    return result


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(
        prog="./surg dev bench control",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures")
    parser.add_argument("--seconds", type=float, default=300.0, help="length of the path [s]")
    parser.add_argument(
        "--offline", action="store_true", help="fetch nothing; use the libraries that are there"
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="rewrite docs/results/benchmark_control.md and its picture",
    )
    options = parser.parse_args()
    try:
        if not 1.0 <= options.seconds <= 3600.0:
            raise CliError(f"--seconds is 1 to 3600, not {options.seconds:g}", 2)
        result = measure(options)
    except CliError as problem:
        warn(f"bench: {problem}")
        sys.exit(problem.code)
    for heading, rows in control_page.tables(result):
        say(f"\n{heading}\n{table(rows)}")
    if options.json:
        paths.write_text(options.json, json.dumps(result, indent=1) + "\n")
        say(f"\nwritten: {options.json}")
    if options.page:
        control_page.PAGE.write_text(control_page.markdown(result), "utf-8")
        control_page.draw(result, control_page.PICTURE)
        say(f"written: {control_page.PAGE}, {control_page.PICTURE}")


if __name__ == "__main__":
    main()
