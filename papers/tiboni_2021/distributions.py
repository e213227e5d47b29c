"""Prints tables 6.2 and 6.3 of Tiboni (2021) beside what this package finds: `python papers/tiboni_2021/distributions.py`.

Masses drawn anew every 10 transitions of the hopper, 100 draws in all, without and with noise; several data sets. A fit can
know no more than the sample that was drawn: z is (estimate - sample's mean) / standard error, the error of a sample of 100
left out of both.
"""

import argparse
import sys
from typing import Any

import numpy as np

from dropo.core.fit import Fit
from dropo.core.table import number, text_table
from dropo.estimators.dropo import DROPO
from dropo.problems.hopper import NOISE, hopper_problem
from dropo.problems.hopper_data import TRUTH, simulate

MEAN = np.array(list(TRUTH.values()))  # torso, thigh, leg, foot [kg]
SPREAD = {"6.2": np.array([0.5, 1e-5, 1e-5, 1e-5]), "6.3": np.array([1e-5, 0.25, 0.25, 0.25])}  # [kg]
EPSILON = {"clean": 1e-8, "noisy": NOISE}
THESIS = {  # its DROPO rows: mean, scale
    ("6.2", "clean"): ((3.524, 3.927, 2.714, 5.090), (0.478, 3.1e-4, 3.4e-4, 1.1e-5)),
    ("6.2", "noisy"): ((3.652, 3.926, 2.719, 5.096), (2.32e-12, 1.19e-11, 3.96e-11, 1.16e-11)),
    ("6.3", "clean"): ((3.534, 3.873, 2.704, 5.083), (0.0004, 0.280, 0.259, 0.226)),
    ("6.3", "noisy"): ((3.537, 3.912, 2.721, 5.105), (0.005, 0.242, 0.216, 0.237)),
}
LIKELIHOODS = ("emulated", "random-effects")
HEADER = ["", *(f"mean m{i}" for i in range(1, 5)), *(f"sd m{i}" for i in range(1, 5)), "log-lik.", "steps", "s"]


def data_set(table: str, kind: str, seed: int) -> tuple[Any, np.ndarray]:
    """The problem, and the masses (100, 4) [kg] behind its data."""
    masses = lambda rng, blocks: MEAN + SPREAD[table] * rng.standard_normal((blocks, 4))
    noise = NOISE if kind == "noisy" else 0.0
    data, drawn = simulate(500, 2, rng=seed, masses=masses, block=10, noise_variance=noise)
    return hopper_problem(f"table {table}, {kind}", data, EPSILON[kind]), drawn


def line(name: str, mean: Any, sd: Any, *rest: str) -> list[str]:
    """A row of the table."""
    return [name, *(number(v, 5) for v in mean), *(number(v, 3) for v in sd), *(rest or ("-",) * 3)]


def found_line(name: str, fit: Fit) -> list[str]:
    """A fit's row."""
    return line(name, fit.mean, fit.sd, f"{fit.log_likelihood:.1f}", f"{fit.simulator_steps:,}", f"{fit.wall_time_s:.1f}")


def errors(fit: Fit, drawn: np.ndarray, varying: np.ndarray) -> np.ndarray:
    """Errors of mean and sd, and z of the mean, of the masses that vary: (3, varying)."""
    off = (fit.mean - drawn.mean(axis=0))[varying]
    return np.stack([off, (fit.sd - drawn.std(axis=0))[varying], off / fit.mean_se[varying]])


def study(table: str, kind: str, seeds: int) -> None:
    """One table, one kind of data: the first data set's rows, then root mean square errors over all."""
    varying, found = SPREAD[table] > 1e-3, {name: [] for name in LIKELIHOODS}
    for seed in range(seeds):
        problem, drawn = data_set(table, kind, seed)
        fits = {name: DROPO(likelihood=name).fit(problem, rng=0) for name in LIKELIHOODS}
        for name, fit in fits.items():
            found[name].append(errors(fit, drawn, varying))
        if seed == 0:
            rows = [line("drawn", drawn.mean(axis=0), drawn.std(axis=0)), *(found_line(name, fit) for name, fit in fits.items())]
    rows.append(line("thesis, DROPO (scale)", *THESIS[table, kind]))
    print(f"table {table}, {kind}\n{text_table(HEADER, rows)}")
    for name, all_errors in found.items():
        mean, sd, z = np.sqrt(np.mean(np.square(all_errors), axis=(0, 2)))
        print(f"{name}, root mean square over {seeds} data sets and the masses that vary: mean {mean:.2g} kg, sd {sd:.2g} kg, z {z:.2g}")
    print(flush=True)


def main() -> int:
    """Runs both tables, both kinds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="data sets of each kind")
    options = parser.parse_args()
    for table in SPREAD:
        for kind in EPSILON:
            study(table, kind, options.seeds)
    return 0


if __name__ == "__main__":
    sys.exit(main())
