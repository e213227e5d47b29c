"""What the files of a result folder must hold, for readers: fit.json, diagnosis.json, run.json and
made.json.

Keys that a reader needs are listed here; others may stand beside them.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from dropo.core.records.figure_data import FigureData
from dropo.core.records.fits.fit import Status
from dropo.core.services.files.file_schema import Saved, check_content
from dropo.core.services.files.saved_files import read_json

Count = Annotated[int, Field(ge=0)]
Known = float | None
"""A number, or null where it is not known."""
Texts = list[str]
ByName = dict[str, Known]
REGRESSION = "regression"
"""The method of a diagnosis by regression alone."""


# fit.json


class SavedParameter(Saved):
    """A fitted parameter."""

    mean: Known
    scale: Known
    sd: Known
    mean_se: Known
    scale_se: Known
    variance_se: Known = None
    degrees: Known = None
    unit: str
    low: float
    high: float
    lower: Known
    upper: Known
    search_scale: Literal["linear", "log"]


class SavedPlace(Saved):
    """Where in a model a parameter is."""

    field: str = ""
    element: str | None = None
    index: Annotated[int, Field(ge=0)] | None = None
    relative: bool = False
    derived: bool = True


class SavedEmulatorCheck(Saved):
    """The simulator beside its emulator."""

    draws: Count
    rows: Count
    simulator: Known
    emulator: Known


class SavedStartFilter(Saved):
    """How filtered start states settled."""

    moves: list[float]
    resets: Count


class SavedResidualSize(Saved):
    """The size of the whitened residuals."""

    mean_square: float
    standard_error: float


class SavedResidualStructure(Saved):
    """The strongest dependence of residuals on state and action."""

    signal: str
    feature: str
    z: float
    held_out_signal: str
    held_out_z: float


class SavedModelCheck(Saved):
    """Whether the model can be right."""

    passed: bool
    size: SavedResidualSize | None = None
    structure: SavedResidualStructure | None = None


class SavedPriors(Saved):
    """What priors are to the means of a fit."""

    laws: dict[str, str]
    share: ByName
    apart: ByName


class SavedHeldOut(Saved):
    """Errors on trajectories that no fit has seen."""

    rows: Count
    steps: Count
    rmse: ByName
    rmse_nominal: ByName = {}


class SavedVarianceTest(Saved):
    """A test that a variance is 0."""

    statistic: float
    p_value: float


class SavedGroupTests(SavedVarianceTest):
    """Whether groups differ."""

    parameters: dict[str, SavedVarianceTest]


class SavedGroups(Saved):
    """The groups that each have one draw of the parameters."""

    of: str
    fewest_rows: Count
    most_rows: Count
    shrinkage: ByName
    median_sd: ByName


class SavedPosterior(Saved):
    """The convergence of a posterior's chains."""

    autocorrelation_time: ByName
    split_r_hat: ByName
    effective_sample_size: ByName


class SavedNoiseTrial(Saved):
    """The fit at one noise variance."""

    epsilon: float
    total_variance: float
    mse: float
    log_likelihood: float


class SavedHorizonTrial(Saved):
    """The fit at one horizon."""

    horizon: Count = Field(alias="lambda")
    below_best: Known
    paired_error: float
    chosen: bool
    mean: list[float]
    mean_se: list[Known]


class SavedSpan(Saved):
    """A span of time that was left out."""

    run: Count
    held_out: bool
    start: float = Field(alias="from")
    end: float = Field(alias="to")
    signal: str
    unit: str
    off: float
    after: float


class SavedFit(Saved):
    """The content of fit.json."""

    method: str
    problem: str
    seed: int | None
    version: str
    parameters: Annotated[dict[str, SavedParameter], Field(min_length=1)]
    correlation: list[list[float]]
    correlation_se: list[list[Known]] | None = None
    family: str
    phi: list[float]
    epsilon: list[float]
    log_likelihood: Known
    mse: Known
    transitions: Annotated[int, Field(ge=1)]
    simulator_steps: Count
    failed_simulations: Count
    objective_evaluations: Count
    inner_evaluations: Count
    wall_time_s: float
    status: Status
    message: str
    warnings: Texts
    places: dict[str, SavedPlace] = {}
    likelihood: str = ""
    optimizer: str = ""
    certified: Texts | None = None
    identifiability: Texts | None = None
    truth: dict[str, float] = {}
    emulator_check: SavedEmulatorCheck | None = None
    filter: SavedStartFilter | None = None
    model_check: SavedModelCheck | None = None
    priors: SavedPriors | None = None
    held_out: SavedHeldOut | None = None
    groups: SavedGroups | None = None
    groups_differ: SavedGroupTests | None = None
    predictive_sd: ByName = {}
    posterior: SavedPosterior | None = None
    tuning: list[SavedNoiseTrial] | None = None
    mse_threshold: float | None = None
    lambda_choice: list[SavedHorizonTrial] | None = None
    disturbances: list[SavedSpan] | None = None


# diagnosis.json


class SavedEstimate(Saved):
    """A quantity of an effect."""

    value: float
    se: Known
    unit: str
    model: Known = None


class SavedAlternative(Saved):
    """An effect that the data cannot tell from a cause."""

    effect: str
    target: str | None
    variant: str = ""
    why: str
    to_tell: str | None = None
    formula: str = ""


class SavedStability(Saved):
    """Where else a cause is named."""

    named: Count
    of: Count
    windows: dict[str, bool]
    halves: Annotated[list[bool], Field(min_length=2, max_length=2)]


class SavedCause(Saved):
    """An effect that held-out data confirm."""

    effect: str
    target: str | None
    variant: str = ""
    estimate: dict[str, SavedEstimate]
    p_value: float
    held_out_gain: float
    held_out_gain_se: float
    rmse_before: float | None
    rmse_after: float | None
    confused_with: list[SavedAlternative]
    acts_like: str | None = None
    stated: bool | None = None
    stability: SavedStability | None = None
    formula: str = ""
    called: str = ""
    to_change: str = ""


class SavedSuspect(Saved):
    """An effect that was not confirmed."""

    effect: str
    target: str | None
    p_value: float
    held_out_gain: float


class SavedLeader(Saved):
    """An effect that would gain enough if the data were sure of it."""

    effect: str
    target: str | None
    variant: str
    gain: float
    gain_se: Known
    times: Known
    why: str = ""
    steps: Count = 0
    record: str


class SavedPlaceOfCause(Saved):
    """An effect and where it acts."""

    effect: str
    target: str | None
    variant: str


class SavedSet(Saved):
    """Causes that the data cannot tell from those that are named."""

    causes: list[SavedPlaceOfCause]
    why: str


class SavedError(Saved):
    """An error, and what sensor noise explains of it."""

    rmse: Known
    noise: float


class SavedHorizon(SavedError):
    """The errors after a horizon."""

    steps: Annotated[int, Field(ge=1)]
    seconds: Known
    units: dict[str, SavedError]


class SavedNominal(Saved):
    """The errors of the model as it came."""

    horizons: list[SavedHorizon]


class SavedModel(SavedNominal):
    """How a model does on data that nothing was fitted to."""

    held_out_log_likelihood: float


class SavedRemaining(Saved):
    """What is still wrong."""

    where: Texts


class SavedOutlierRun(Saved):
    """A run that disagrees with the others."""

    run: int
    parameter: str
    unit: str
    value: float
    se: float
    others: float
    held_out: bool


class SavedReplayedRun(Saved):
    """The errors of a run by signal."""

    seconds: float
    nominal: ByName
    extended: ByName


class SavedReplayErrors(Saved):
    """The errors of all runs."""

    nominal: float
    extended: float


class SavedOddReplay(Saved):
    """A run in which one signal is off by far more than in the others."""

    run: int
    signal: str
    unit: str
    error: float
    usual: float


class SavedReplay(Saved):
    """Whole runs held out, by commands alone."""

    units: dict[str, SavedReplayErrors]
    runs: list[SavedReplayedRun]
    odd: list[SavedOddReplay] = []


class SavedLeftOut(Saved):
    """What was left out of a diagnosis."""

    spans: list[SavedSpan]


class SavedFinding(Saved):
    """What every kind of diagnosis.json holds."""

    verdict: str
    headline: str
    problem: str
    causes: list[SavedCause]
    suspects: list[SavedSuspect]
    leaders: list[SavedLeader]
    alternatives: list[SavedSet]
    warnings: Texts
    version: str
    simulator_steps: Count
    wall_time_s: float


class SavedDetectable(Saved):
    """The size of an effect that the data would have shown."""

    effect: str
    target: str | None
    variant: str
    quantity: str
    unit: str
    size: Known


class SavedEvidence(Saved):
    """How much of the forces a fault explains."""

    removed: float
    gain: float
    gain_se: float
    before: float
    after: float
    p_value: float


class SavedFault(Saved):
    """Commands or angles that do not mean what the model takes them for."""

    kind: str
    target: str
    text: str
    of: str = ""
    factor: float | None = None
    to_change: str = ""
    evidence: SavedEvidence | None = None


class SavedLearnedForce(Saved):
    """A force at a joint that was learned."""

    joint: str
    variables: Texts
    largest: float
    unit: str
    formula: str


class SavedLearned(Saved):
    """Forces that were learned from what nothing explains."""

    forces: list[SavedLearnedForce]
    held_out_gain: float
    held_out_gain_se: float
    share: float
    used: bool


class SavedDiagnosis(SavedFinding):
    """The content of diagnosis.json of a search by simulation."""

    status: Literal["done", "interrupted"] = "done"
    window_steps: Count
    baseline: SavedModel
    extended: SavedModel
    remaining: SavedRemaining
    nominal: SavedNominal | None = None
    parameters: dict[str, float] = {}
    odd_runs: list[SavedOutlierRun] = []
    replay: SavedReplay | None = None
    disturbances: SavedLeftOut | None = None
    undetermined: Texts = []
    numerics: Texts = []
    faults: list[SavedFault] = []
    detectable: list[SavedDetectable] = []
    learned: SavedLearned | None = None
    pictures: FigureData | None = None


class SavedForces(Saved):
    """What a joint's drive gives, and what is not explained of it."""

    joint: str
    unit: str
    drive: float
    before: float
    after: float
    used: float


class SavedQuickDiagnosis(SavedFinding):
    """The content of diagnosis.json of a regression alone."""

    faults: list[SavedFault]
    forces: list[SavedForces]


class SavedDifference(Saved):
    """One thing that differs in a run."""

    effect: str
    target: str | None
    variant: str
    estimate: dict[str, SavedEstimate]
    confused_with: Texts


class SavedComparedRun(Saved):
    """One run beside the reference runs."""

    run: str
    reference: bool
    differs: bool
    p_value: float
    causes: list[SavedDifference]
    numbers: list[float]


class SavedNumber(Saved):
    """A number that describes runs, over the reference runs."""

    name: str
    mean: float
    sd: float


class SavedComparison(Saved):
    """The content of runs.json."""

    problem: str
    headline: str
    level: float
    numbers: list[SavedNumber]
    tolerances: Texts
    runs: list[SavedComparedRun]
    simulator_steps: Count
    version: str


def read_comparison(path: Path) -> dict[str, Any]:
    """Read runs.json, of runs beside reference runs.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict
        Its content as it stands there.

    Raises
    ------
    BadFile
        If there is no such file, it is of a newer version, or it does not fit its schema.
    """
    content = read_json(path, "a comparison of runs written by `dropo diagnose --out`")
    check_content(path, content, SavedComparison)
    return content


def read_diagnosis(path: Path) -> dict[str, Any]:
    """Read diagnosis.json, of a search by simulation or of a regression alone.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict
        Its content as it stands there.

    Raises
    ------
    BadFile
        If there is no such file, it is of a newer version, or it does not fit its schema.
    """
    content = read_json(path, "a diagnosis written by `dropo diagnose --out`")
    quick = content.get("method") == REGRESSION
    check_content(path, content, SavedQuickDiagnosis if quick else SavedDiagnosis)
    return content


# run.json and made.json


class SavedDeclared(Saved):
    """A parameter as the problem declares it."""

    name: str
    unit: str = ""
    low: float
    high: float


class SavedRun(Saved):
    """The content of run.json, and the header of an evaluation log."""

    problem: str | None = None
    method: str | None = None
    seed: int | None = None
    version: str = ""
    settings: dict[str, Any] = {}
    parameters: list[SavedDeclared] = []
    priors: dict[str, str] = {}
    transitions: Count | None = None
    data_sha256: str | None = None
    model_sha256: str | None = None


class SavedMade(Saved):
    """The content of made.json."""

    command: str
    problem: str
    versions: dict[str, str]
