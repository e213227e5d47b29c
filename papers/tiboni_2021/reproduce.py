"""Prints table 6.1 of Tiboni (2021) beside what this package finds: `python papers/tiboni_2021/reproduce.py`.

Four data sets: the authors' published transitions and our own simulated ones, each without and with noise. Three methods.
Every fit's law is judged by the same likelihood: that of the thesis at its epsilon, from 100 draws.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from dropo.core.catalogue import find
from dropo.core.errors import BadFile
from dropo.core.fit import Fit
from dropo.core.problem import Problem
from dropo.core.table import number, text_table
from dropo.likelihoods.gaussian import Gaussian
from dropo.problems.reader import load

EXPECTED = Path(__file__).with_name("expected.json")
SETS = ("hopper-published", "hopper-published-noisy", "hopper", "hopper-noisy")
METHODS = ("dropo", "droid", "least-squares")
MASSES = ("m1", "m2", "m3", "m4")  # torso, thigh, leg, foot
THESIS = {  # table 6.1: all means equal the truth to the printed digit, 0.001 kg
    "dropo": {"clean": (1.0e-5, 1.1e-5, 1.1e-5, 1.0e-5), "noisy": (1.0e-5,) * 4},
    "droid": {"clean": (1.2e-12, 2.1e-12, 2.0e-12, 1.1e-12), "noisy": (1.2e-12, 2.4e-11, 2.0e-12, 1.2e-12)},
}
PRINTED = 5e-4  # [kg] half the last digit that the table prints


def judged(problem: Problem, family: str, phi: np.ndarray) -> float:
    """The thesis' log-likelihood of a law at the problem's epsilon, from 100 draws [nats]."""
    law, rng = find("families", family)(problem.space), np.random.default_rng(0)
    return Gaussian().bind(problem.simulator, problem.segments, law, problem.epsilon, rng)(phi)


def row_of(problem: Problem, fit: Fit, truth: np.ndarray) -> dict[str, Any]:
    """What the table and the expected values keep of a fit."""
    return {
        "error": (fit.mean - truth).tolist(), "se": np.nan_to_num(fit.mean_se, nan=-1.0).tolist(), "scale": fit.scale.tolist(),
        "log_likelihood": judged(problem, fit.family, fit.phi), "steps": fit.simulator_steps, "seconds": round(fit.wall_time_s, 1),
    }  # fmt: skip


def reproduce(name: str, threads: int) -> dict[str, dict[str, Any]]:
    """The rows of one data set: each method's, and the truth's own likelihood."""
    problem = load(name, threads=threads)
    truth = problem.space.vector(problem.truth or {})
    rows = {}
    for method in METHODS:
        print(f"{name}: {method} ...", file=sys.stderr, flush=True)
        try:
            rows[method] = row_of(problem, find("methods", method)().fit(problem, rng=0), truth)
        except np.linalg.LinAlgError as error:
            rows[method] = {"failed": str(error)}
    law = find("families", "truncated_gaussian")(problem.space)
    rows["truth"] = {"log_likelihood": judged(problem, "truncated_gaussian", law.phi(truth, np.full(4, 1e-5)))}
    return rows


def table(name: str, rows: dict[str, dict[str, Any]]) -> str:
    """One data set's rows, each method's above the thesis' own."""
    kind = "noisy" if name.endswith("noisy") else "clean"
    header = ["method", *(f"{m} error" for m in MASSES), "scale m1", "scale m2", "scale m3", "scale m4", "log-lik.", "steps", "s"]
    lines = []
    for method in METHODS:
        row = rows[method]
        if "failed" in row:
            lines.append([method, f"FAILED: {row['failed']}", *["-"] * 10])
            continue
        lines.append([method, *(f"{e:+.1e}" for e in row["error"]), *(number(s, 2) for s in row["scale"]),
                      f"{row['log_likelihood']:.2f}", f"{row['steps']:,}", f"{row['seconds']:.1f}"])  # fmt: skip
        if method in THESIS:
            lines.append([f"  thesis, {method}", *["< 5e-4"] * 4, *(f"{s:.1e}" for s in THESIS[method][kind]), "-", "-", "-"])
    lines.append(["truth, scale 1e-5", *["0"] * 4, *["1e-05"] * 4, f"{rows['truth']['log_likelihood']:.2f}", "-", "-"])
    return f"{name}\n{text_table(header, lines)}"


def contradictions(name: str, rows: dict[str, dict[str, Any]]) -> list[str]:
    """Where these rows contradict the thesis' table, in sentences."""
    row, out = rows["dropo"], []
    if "failed" in row:
        return out
    error, se, scale = (np.array(row[key]) for key in ("error", "se", "scale"))
    gain = row["log_likelihood"] - rows["truth"]["log_likelihood"]
    if (np.abs(error) > PRINTED).any():
        chance = float(np.prod(2 * ndtr(PRINTED / se) - 1))
        errors = ", ".join(f"{s:.4f}" for s in se)
        out.append(
            f"{name}: the thesis prints the truth to 0.001 kg. The best fit is up to {np.abs(error).max():.4f} kg off and {gain:.2f} nat"
            f" better than the truth; with standard errors {errors} kg, four estimates round to the truth with probability {chance:.0e}."
        )
    if (scale > 1e-4).any():
        out.append(f"{name}: the thesis prints scales of 1e-5; the best fit has {scale.max():.2g} kg for {MASSES[int(scale.argmax())]}.")
    return out


def differences(found: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Where the rows are farther from the expected ones than the tolerances allow."""
    out = []
    for name, rows in found.items():
        for method, row in rows.items():
            kind = "noisy" if name.endswith("noisy") else "clean"
            if "failed" in row:
                out.append(f"{name}, {method}: {row['failed']}")
                continue
            allowed, wanted = expected["tolerances"][kind][method], expected["rows"][name][method]
            for key, tolerance in allowed.items():
                off = float(np.abs(np.subtract(row[key], wanted[key])).max())
                if not off <= tolerance:
                    out.append(f"{name}, {method}: {key} is {off:.3g} off, more than {tolerance:g}")
    return out


def main() -> int:
    """Runs what can be run, prints, and compares with expected.json where asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=SETS, action="append", help="these data sets alone")
    parser.add_argument("--check", action="store_true", help="compare with expected.json; exit status 1 where they differ")
    parser.add_argument("--json", type=Path, help="write the rows here")
    parser.add_argument("--threads", type=int, default=0, help="0: all cores")
    options = parser.parse_args()
    found, notes = {}, []
    for name in options.only or SETS:
        try:
            rows = reproduce(name, options.threads)
        except (BadFile, OSError) as error:
            print(f"SKIPPED {name}: its data are not at hand ({error})\n", flush=True)
            continue
        found[name] = rows
        notes += contradictions(name, rows)
        print(table(name, rows) + "\n", flush=True)
    print("\n- ".join(["Where this contradicts the thesis:", *notes]) if notes else "Nothing here contradicts the thesis.")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    if not options.check:
        return 0
    wrong = differences(found, json.loads(EXPECTED.read_text()))
    print("\n".join(wrong) or "All as expected.")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
