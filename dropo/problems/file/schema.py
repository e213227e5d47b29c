"""The schema of problem files: every key with its type, its default and a sentence for editors."""

from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field, WithJsonSchema, model_validator

from dropo.core.services.files.file_schema import (
    BY_SHAPE,
    LIST,
    MAPPING,
    SINGLE,
    Count,
    Entry,
    Expected,
    ExpectedName,
    Finite,
    Key,
    NonNegative,
    Number,
    Place,
    Positive,
    Whole,
    Word,
    refuse,
)

BUILT_IN_MODELS = {"hopper": "dropo.problems.hopper.model:hopper_spec"}
"""Models of built-in problems, by the name that `model` takes: functions that return an MjSpec."""

MODEL = f"an MJCF file, or the name of a built-in model ({', '.join(BUILT_IN_MODELS)})"
FUNCTION = "a function as module:name, or file.py:name beside the problem file"
PARAMETER = "a mapping with field, low and high"
EFFECTS = "a list of mappings with effect, target, and sizes or fit"
MOTOR = "the name of a motor, or a mapping with its numbers"
RUNS = "names of runs, or patterns such as 'A0_*'"
RESET = "'transition', 'start', or {set: [observation items]}"
HELD_OUT = "a list of trajectory numbers, or data as in `data`"

MOST_FRAMES = 100_000
"""Physics steps in a control step, far more than any machine needs."""

Function = Annotated[Word, Expected(FUNCTION)]
Variance = Annotated[Finite, Field(ge=0), Expected("a variance, 0 or more")]
Items = Annotated[list[Word], Field(min_length=1)]
Bounds = Annotated[
    list[Finite], Field(min_length=2, max_length=2), Expected("[low, high], two numbers")
]


class ParameterEntry(Entry):
    """A number of the model that may be fitted."""

    field: Annotated[Word, Expected("a field of MjModel or mjOption, such as body_mass")]
    """An array of MjModel, such as body_mass, or an entry of mjOption, such as gravity."""
    name: (
        Annotated[
            Annotated[Word, SINGLE] | Annotated[list[Word], Field(min_length=1), LIST],
            BY_SHAPE,
            Expected("the name of an element, a pattern such as '*', or a list of names"),
        ]
        | None
    ) = None
    """The body, joint, geom, actuator or other element that the number belongs to; with a list or
    a pattern such as '*' there is such a parameter for each element."""
    shared: Annotated[bool, Expected("true, where all named elements have one value, or false")] = (
        False
    )
    """Whether all elements of `name` share one value, or with `target: relative` one factor."""
    index: Place | None = None
    """The place in the element's row, where the row has several numbers."""
    low: Number
    """The lower end of the search interval."""
    high: Number
    """The upper end of the search interval."""
    unit: Annotated[str, Expected("a text, such as kg")] = ""
    """The unit, a text for tables."""
    target: Annotated[Literal["absolute", "relative"], ExpectedName("a known target")] = "absolute"
    """With `relative`, the value is a factor on the model's own number."""
    derived: Annotated[Literal["follow", "keep"], ExpectedName("what derived constants do")] = (
        "follow"
    )
    """Whether constants that MuJoCo derives follow the number, or are kept as they are."""
    prior: Annotated[Word, Expected("a text such as 'normal(3.5, 0.2)'")] | None = None
    """What is known beforehand, for a posterior, such as normal(3.5, 0.2)."""

    @model_validator(mode="after")
    def _check_interval(self) -> "ParameterEntry":
        if self.low >= self.high:
            refuse(f"a number below high = {self.high:g}", key="low", got=f"{self.low:g}")
        return self


class HeldOutEntry(Entry):
    """Runs that no fit sees."""

    runs: Annotated[list[Word], Field(min_length=1), Expected(RUNS)]
    """The runs by name, as import.json lists them, or patterns such as 'A0_*'."""


class ResetEntry(Entry):
    """A partial reset."""

    set: Annotated[Items, Expected("a list of observation items such as [qpos]")]
    """The observation items that every segment takes from the measurement; the others run on."""


class EffectEntry(Entry):
    """Something that the machine has and MJCF has no field for."""

    model_config = ConfigDict(
        json_schema_extra={"oneOf": [{"required": ["sizes"]}, {"required": ["fit"]}]}
    )
    nullable: ClassVar[frozenset[str]] = frozenset({"target"})

    effect: Annotated[Word, Expected("an effect")]
    """The name of the effect, one of `dropo list effects`."""
    target: Annotated[
        str | None,
        WithJsonSchema({"type": ["string", "null"]}),
        Expected("the name of a place, or null"),
    ] = None
    """The body, joint, actuator or signal that has it; null for the whole machine."""
    variant: Annotated[str, Expected("the name of a variant")] = ""
    """The variant of the effect, where it has several."""
    formula: Annotated[str, Expected("a formula")] = ""
    """The formula of a law, such as -c * abs(v) * v, whose constants are its quantities."""
    sizes: Annotated[dict[Key, Number], Expected("a mapping from quantities to sizes")] | None = (
        None
    )
    """The sizes of an effect that is there, by quantity."""
    fit: (
        Annotated[dict[Key, Bounds], Expected("a mapping from quantities to [low, high]")] | None
    ) = None
    """The search intervals of an effect that is fitted, by quantity."""


class MotorEntry(Entry):
    """A motor with its gear, by the numbers of its data sheet."""

    label: Annotated[str, Expected("a text")] = ""
    """The motor's name."""
    gear_ratio: Positive = 1.0
    """Turns of the motor for one of the joint."""
    rotor_inertia: NonNegative | None = None
    """The rotor's inertia before the gear [kg m^2]."""
    torque_constant: Positive | None = None
    """The torque of a current before the gear [N m / A]."""
    rated_torque: Positive | None = None
    """The torque behind the gear that the motor may give for any time [N m]."""
    peak_torque: Positive | None = None
    """The largest torque behind the gear [N m]."""
    no_load_speed: Positive | None = None
    """The speed behind the gear without load [rad/s]."""
    coulomb: NonNegative | None = None
    """Dry friction behind the gear [N m]."""
    viscous: NonNegative | None = None
    """Viscous friction behind the gear [N m s/rad]."""
    source: Annotated[str, Expected("a text")] = ""
    """Where the numbers come from."""


class TaskEntry(Entry):
    """What a policy is to do."""

    reward: Function
    """The reward of a step: reward(before, actions, after), as module:name or file.py:name."""
    alive: Function | None = None
    """Which states an episode goes on in, as module:name or file.py:name."""
    starts: Function | None = None
    """The states in which episodes begin; by default those of the recordings."""
    steps: Count = 500
    """The policy's steps in a whole episode."""
    bonus: Number = 0.0
    """What each step is worth on top that leaves the simulation alive."""


class ProblemFile(Entry):
    """A problem file of dropo: what was measured, with which model, and what may be fitted."""

    model: Annotated[Word, Expected(MODEL)]
    """An MJCF file, by its path from this file, or the name of a built-in model."""
    frame_skip: Annotated[
        int,
        Field(ge=1, le=MOST_FRAMES),
        Expected(f"a whole number from 1 to {MOST_FRAMES}"),
    ] = 1
    """Physics steps for which one action is held."""
    data: Annotated[
        Word | Annotated[list[Word], Field(min_length=1)],
        Expected("a file, a folder or a list of them"),
    ]
    """The measured data: a file, a folder, a Minari data set, or a list of them."""
    observation: Annotated[Items, Expected("a list of items such as [qpos, qvel]")] = [
        "qpos",
        "qvel",
    ]
    """The columns of an observation row, in order: qpos, qvel, act, sensordata or parts of them."""
    action: Annotated[Items, Expected("a list of items such as [ctrl]")] = ["ctrl"]
    """The columns of an action row, in order: ctrl or parts of it."""
    parameters: Annotated[
        dict[Key, Annotated[ParameterEntry, Expected(PARAMETER)]],
        Expected("a mapping from names to parameters"),
    ] = {}
    """The numbers of the model that may be fitted, by names of your own."""
    horizon: Count = Field(1, alias="lambda")
    """Control steps in a segment."""
    whole_runs: Annotated[
        bool, Expected("true, where start states are to be found along whole runs, or false")
    ] = False
    """Whether a fit finds the start states of whole runs where it can, in windows of `lambda`."""
    epsilon: (
        Annotated[
            Annotated[Variance, SINGLE]
            | Annotated[list[Variance], LIST]
            | Annotated[dict[Key, Variance], MAPPING],
            BY_SHAPE,
            Expected("a variance, 0 or more"),
        ]
        | None
    ) = None
    """The variance of the noise: one number, one for each signal, or by name; else learned."""
    noise: (
        Annotated[Literal["auto", "gaussian"], ExpectedName("what learned noise may be")] | None
    ) = None
    """What learned noise may be: "auto", long tails too, or "gaussian" alone."""
    start_noise: Annotated[
        bool, Expected("true, where the measured start states carry the noise too, or false")
    ] = False
    """Whether the measured start states carry the noise too."""
    start: Annotated[
        dict[Key, Annotated[Finite, Expected("a number within the parameter's bounds")]],
        Expected("a mapping from parameters to the values where a search begins"),
    ] = {}
    """Where a search begins, by parameter; the others begin in the middle of their bounds."""
    student_t: (
        Annotated[Finite, Field(gt=2), Expected("degrees of freedom, a number above 2")] | None
    ) = None
    """Degrees of freedom of a Student t in the place of Gaussian noise."""
    reset: Annotated[
        Annotated[Literal["transition", "start"], Expected(RESET), SINGLE]
        | Annotated[ResetEntry, MAPPING],
        BY_SHAPE,
        Expected(RESET),
    ] = "transition"
    """Where segments start: at every transition, at a trajectory's start, or partial resets."""
    input: (
        Annotated[Word, Expected("the name of a logged command, where the data hold several")]
        | None
    ) = None
    """Of several logged commands, the one that drives the model."""
    transitions: Count | None = None
    """Fit the first so many transitions alone."""
    effects: Annotated[list[EffectEntry], Expected(EFFECTS)] = []
    """What the machine has and MJCF has no field for, with its sizes or to be fitted."""
    motors: Annotated[
        dict[
            Key,
            Annotated[
                Annotated[Word, Expected(MOTOR), SINGLE] | Annotated[MotorEntry, MAPPING],
                BY_SHAPE,
                Expected(MOTOR),
            ],
        ],
        Expected("a mapping from joints to motors, such as {shoulder: ak80-6}"),
    ] = {}
    """Motors by joint: the name of one in the library, or its numbers."""
    reference: Annotated[list[Word], Expected(RUNS)] = []
    """The normal runs, by name or pattern: a diagnosis says what differs from them in each run."""
    task: (
        Annotated[
            Annotated[Word, Expected(FUNCTION), SINGLE] | Annotated[TaskEntry, MAPPING],
            BY_SHAPE,
            Expected(f"a mapping with reward, or {FUNCTION}"),
        ]
        | None
    ) = None
    """What a policy is to do: a mapping with its reward, or a function that returns a Task."""
    held_out: (
        Annotated[
            Annotated[
                Annotated[list[Whole], Field(min_length=1)]
                | Annotated[list[Word], Field(min_length=1)],
                LIST,
            ]
            | Annotated[Word, SINGLE]
            | Annotated[HeldOutEntry, MAPPING],
            BY_SHAPE,
            Expected(HELD_OUT),
        ]
        | None
    ) = None
    """What no fit sees: trajectory numbers of `data`, {runs: [names]} of it, or other data."""
    estimated: Annotated[
        dict[Key, NonNegative], Expected("a mapping from signals to standard deviations")
    ] = {}
    """Signals of the data that were estimated rather than measured, with the estimates' errors."""
    plugins: Annotated[list[Word], Expected("a list of Python files, such as [my_parts.py]")] = []
    """Python files with parts of your own, by their paths from this file; they are run."""
    robot: Annotated[Word, Expected("the robot's name")] | None = None
    """The robot's name, for titles; left out, the file's."""

    @model_validator(mode="after")
    def _check_reset(self) -> "ProblemFile":
        if self.reset == "start" and "horizon" in self.model_fields_set:
            expected = "none with `reset: start`, where a segment is a whole trajectory"
            refuse(expected, key="lambda", got=str(self.horizon))
        if self.reset != "transition" and self.whole_runs:
            expected = "false with a `reset` other than `transition`"
            refuse(expected, key="whole_runs", got="true")
        return self
