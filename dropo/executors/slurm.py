"""Executors of clusters with SLURM, through submitit: each call is a job of an array."""

import queue
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from dropo.core.services.errors import DropoError
from dropo.core.services.optional_dependencies import need
from dropo.core.services.validation import known, require

FOLDER = "slurm_jobs"
"""Where jobs and their answers are written, in the working folder: the nodes must see it."""
MOST_STARTS = 3
"""How often a job is started whose node is lost."""
GATHER = 0.2
"""How long calls are gathered into one array of jobs [s]."""
NUMBERS = {
    "time": ("timeout_min", 60),
    "cpus": ("cpus_per_task", 1),
    "mem": ("mem_gb", 4),
    "jobs": ("slurm_array_parallelism", 256),
}
"""Setting -> submitit's name of it, and its default [min, cores, GB, jobs at a time]."""
WORDS = {"account": "slurm_account", "qos": "slurm_qos", "constraint": "slurm_constraint"}
"""Setting -> submitit's name of it."""


@contextmanager
def slurm(place: str) -> Iterator[Executor]:
    """Jobs of SLURM, as in slurm:PARTITION,time=60,mem=4,cpus=1,jobs=256 (minutes, GB, at once).

    Parameters
    ----------
    place : str
        "PARTITION,time=60,mem=4,cpus=1,jobs=256" [minutes, GB, cores, jobs at a time], of which all
        but the partition may be left out; also account, qos and constraint.

    Yields
    ------
    concurrent.futures.Executor
        Jobs that are left in the end are cancelled.

    Raises
    ------
    MissingPackage
        If submitit is missing.
    BadArgument
        If the place has no partition, or a setting has no valid value.
    UnknownName
        If there is no setting of that name.
    DropoError
        If there is no sbatch or no srun on the path.
    """
    need("submitit", extra="slurm", caller="The executor 'slurm'")
    import submitit

    parameters = _parameters(place)
    if shutil.which("sbatch") is None or shutil.which("srun") is None:
        raise DropoError("SLURM is not here: there is no sbatch or no srun on the path.")
    Path(FOLDER).mkdir(exist_ok=True)
    folder = Path(tempfile.mkdtemp(dir=FOLDER)).resolve()
    jobs = submitit.AutoExecutor(folder=folder, cluster="slurm")
    jobs.update_parameters(**parameters)
    executor = SlurmExecutor(jobs)
    try:
        yield executor
    finally:
        executor.shutdown(cancel_futures=True)
    shutil.rmtree(folder)


class Call(NamedTuple):
    """A call that waits for its job, or runs in it.

    Attributes
    ----------
    answer : Future
        Of what it returns.
    run : callable
        What is called.
    args : tuple
        By place.
    options : dict
        By name.
    starts : int
        How often its job has been started.
    """

    answer: Future[Any]
    run: Callable[..., Any]
    args: tuple[Any, ...]
    options: dict[str, Any]
    starts: int = 0


class SlurmExecutor(Executor):
    """Runs calls as jobs of SLURM; a job whose node is lost is started again.

    Parameters
    ----------
    jobs : submitit.Executor
        It knows partition, time and folder.
    """

    def __init__(self, jobs: Any):
        self._jobs = jobs
        self._waiting: queue.SimpleQueue[Call] = queue.SimpleQueue()
        self._is_open = True
        self._running: list[tuple[Call, Any]] = []
        self._max_workers = int(jobs.parameters.get("array_parallelism", 1))
        self._keeper = threading.Thread(target=self._keep, name="slurm", daemon=True)
        self._keeper.start()

    def submit(self, call: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        """Run a call in a job of its own, gathered with others into an array of jobs.

        Parameters
        ----------
        call : callable
            What runs there; submitit pickles it.
        *args : Any
            Its arguments.
        **options : Any
            Its arguments by name.

        Returns
        -------
        concurrent.futures.Future
            What the call gives, or the error that it ends in; a `DropoError` where SLURM refuses
            the job or loses it too often.
        """
        answer: Future[Any] = Future()
        self._waiting.put(Call(answer, call, args, options))
        return answer

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Stop looking after jobs.

        Parameters
        ----------
        wait : bool
            It is not looked at: the call waits as long as `cancel_futures` says.
        cancel_futures : bool
            Whether SLURM cancels the jobs that are left; else their end is awaited.
        """
        if not cancel_futures:
            while self._running or not self._waiting.empty():
                time.sleep(GATHER)
        self._is_open = False
        self._keeper.join()
        for call, job in self._running:
            if not call.answer.done():
                job.cancel(check=False)

    def _keep(self) -> None:
        """Hand waiting calls to SLURM and pass on the answers of jobs, until shut down."""
        while self._is_open:
            time.sleep(GATHER)
            calls = [self._waiting.get() for _ in range(self._waiting.qsize())]
            calls = [call for call in calls if not call.answer.cancelled()]
            if calls:
                self._start(calls)
            self._look()

    def _start(self, calls: list[Call]) -> None:
        """Submit calls as one array of jobs."""
        try:
            with self._jobs.batch():
                jobs = [self._jobs.submit(_outcome, c.run, c.args, c.options) for c in calls]
        except Exception as error:
            refusal = DropoError(f"SLURM refused the jobs: {_last_line(error)}")
            for call in calls:
                call.answer.set_exception(refusal)
            return
        for call, job in zip(calls, jobs, strict=True):
            self._running.append((call._replace(starts=call.starts + 1), job))

    def _look(self) -> None:
        """Pass on the answers of jobs that have ended; drop those that nobody waits for."""
        left = []
        for call, job in self._running:
            if call.answer.cancelled():
                job.cancel(check=False)
            elif job.done():
                self._end(call, job)
            else:
                left.append((call, job))
        self._running = left

    def _end(self, call: Call, job: Any) -> None:
        """Pass on what a job ended in, or start it again where there is no answer."""
        import submitit

        try:
            value, error = job.result()
        except (
            submitit.core.utils.UncompletedJobError,
            submitit.core.utils.FailedJobError,
        ) as lost:
            if call.starts < MOST_STARTS:
                self._waiting.put(call)
                return
            said = f"Job {job.job_id} was lost {call.starts} times: {_last_line(lost)}"
            value = None
            error = DropoError(said)
        if error is None:
            call.answer.set_result(value)
        else:
            call.answer.set_exception(error)


def _outcome(
    run: Callable[..., Any], args: tuple[Any, ...], options: dict[str, Any]
) -> tuple[Any, Exception | None]:
    """What a call gives, and the exception that it ends in, which travels as itself."""
    try:
        return run(*args, **options), None
    except Exception as error:
        return None, error


def _parameters(place: str) -> dict[str, Any]:
    """What submitit takes, of "PARTITION,KEY=VALUE,..."."""
    partition, *settings = place.split(",")
    rule = "slurm:PARTITION, then perhaps time=60,mem=4,cpus=1,jobs=256"
    require(partition != "" and "=" not in partition, "--executor", rule, f"slurm:{place}", "slurm")
    found: dict[str, Any] = dict(NUMBERS.values())
    found["slurm_partition"] = partition
    for setting in settings:
        key, _, value = setting.partition("=")
        if known("setting of slurm", key, [*NUMBERS, *WORDS]) in WORDS:
            require(value != "", key, "a word behind its =", setting, "slurm")
            found[WORDS[key]] = value
        else:
            is_number = value.isdecimal() and int(value) > 0
            require(is_number, key, "a whole number above 0", value, "slurm")
            found[NUMBERS[key][0]] = int(value)
    return found


def _last_line(error: BaseException) -> str:
    """The last line that an error says."""
    return (str(error).strip().splitlines() or [type(error).__name__])[-1]
