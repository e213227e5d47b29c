"""The hopper transitions published with DROPO.

Source: github.com/gabrieletiboni/dropo, MIT licence, (c) 2022 Gabriele Tiboni.
"""

import numpy as np

from dropo.core.contracts.problem import Problem
from dropo.core.records.trajectories import Trajectories
from dropo.data.reading import read
from dropo.problems.hopper.problem import NOISE, hopper_problem
from dropo.problems.measured.external_data import fetch_arrays, find_data

SOURCE = (
    "https://raw.githubusercontent.com/gabrieletiboni/dropo/"
    "a9861643bc8e183dc899084bb58dc2255a3429b5/datasets"
)
EPISODE = 500  # transitions of each of the 20 trajectories
FIRST = 1000  # transitions that the thesis fits
FILES = {
    "clean": "hopper10000/hoppermass_n10000",
    "noisy-1e-5": "hoppernoisy1e-510000/hopper_n10000",
}
DIGESTS = {
    "clean": (
        "67a6934c06a6a84e0b7b34e03b4574b159de1d034fa080ddf3fa7477738281fe",
        "27b6ce4f6d0f826f261f8233dab031e115aada2e2ea19baa242714d2c556e095",
        "5afe0240ef830ea37f364f01c1f02b1728241c3d2c2ff506639ba8cb5f5b8e72",
    ),
    "noisy-1e-5": (
        "f7e0a77f0d6f3f2947f976bc1854eac0d7d40e63495b22139ecb219f1ab7ab64",
        "7fc718aafcd19654a160bd14373baf6b24529efae50841d66b18ccf1a3066a00",
        "50e9f7785500f556a96d5446f4d74e684ddcdfd97980be333f43b302aecad121",
    ),
}
"""sha256 of the float64 content of observations, actions and next observations."""
KEYS = {
    "observations": "observations",
    "actions": "actions",
    "next_observations": "nextobservations",
}
"""Field of the trajectories -> its word in the names of the authors' files."""


def published(which: str) -> Trajectories:
    """All 10,000 published transitions of one set.

    They are read from the external data, or fetched once into the user's cache.

    Parameters
    ----------
    which : str
        "clean" or "noisy-1e-5".

    Returns
    -------
    Trajectories
        20 trajectories of 500 transitions; 11 observed signals, 3 commands.

    Raises
    ------
    BadFile
        If the data are neither found nor fetched, or if fetched data have another content.
    """
    path = find_data(f"hopper-published/{which}.npz")
    if path is not None:
        return read(path)
    files = {}
    for (key, word), digest in zip(KEYS.items(), DIGESTS[which], strict=True):
        files[key] = (f"{FILES[which]}_{word}.npy", digest)
    arrays = fetch_arrays(SOURCE, files)
    ends = np.arange(len(arrays["observations"])) % EPISODE == EPISODE - 1
    return Trajectories(
        arrays["observations"], arrays["actions"], arrays["next_observations"], ends
    )


def hopper_published(threads: int = 0) -> Problem:
    """The authors' 10,000 transitions without noise (table 6.1).

    The first 1000 are fitted unless more are asked for.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With four masses to fit.

    Raises
    ------
    BadFile
        If the data are neither found nor fetched.
    """
    data = published("clean")
    return hopper_problem("hopper-published", data.head(FIRST), 1e-8, threads, everything=data)


def hopper_published_noisy(threads: int = 0) -> Problem:
    """The authors' transitions with noise of variance 1e-5 on the next observations (table 6.1).

    The first 1000 are fitted unless more are asked for.

    Parameters
    ----------
    threads : int
        Threads of the simulator; 0 for all cores.

    Returns
    -------
    Problem
        With four masses to fit.

    Raises
    ------
    BadFile
        If the data are neither found nor fetched.
    """
    data = published("noisy-1e-5")
    return hopper_problem(
        "hopper-published-noisy", data.head(FIRST), NOISE, threads, everything=data
    )
