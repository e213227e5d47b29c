"""Numbers that decide in a diagnosis."""

from dataclasses import dataclass, field

from dropo.diagnosis.far_off.search import FarOffSettings
from dropo.diagnosis.far_off.start import FarOffLimits
from dropo.diagnosis.findings.accuracy.every_horizon import EveryHorizonSettings
from dropo.diagnosis.findings.limits.detectable import DetectableSettings
from dropo.diagnosis.laws.discovery import LawSettings
from dropo.diagnosis.laws.learned import LearnedSettings
from dropo.diagnosis.regression.quick import QuickSettings
from dropo.diagnosis.regression.wiring import WiringSettings
from dropo.diagnosis.search.confirmation import SelectionSettings
from dropo.diagnosis.search.sets import SetSettings
from dropo.diagnosis.search.whitening import WhitenessSettings
from dropo.diagnosis.search.window_length import WindowLengthSettings
from dropo.evaluation.held_out import HeldOutSettings

EACH = HeldOutSettings(maximum=120, maximum_steps=1200, minimum=10)
"""A quarter of the usual windows."""


@dataclass(frozen=True)
class DiagnosisSettings:
    """Numbers that decide in a diagnosis.

    Attributes
    ----------
    windows : int
        About how many windows are fitted, and how many are held out, unless something else is
        asked for ...
    long_windows : int
        ... and where velocities were estimated, which makes windows long.
    selection : SelectionSettings
        When an effect is accepted.
    window_length : WindowLengthSettings
        How the windows' horizon is chosen.
    noise : WhitenessSettings
        When the sensors' noise is not taken to be white.
    horizons : EveryHorizonSettings
        When errors after a horizon that is printed speak against an effect, or the verdict.
    nothing : float
        An effect whose size is nothing within an interval of this level is no cause.
    detectable : DetectableSettings
        How it is found what the data of a consistent model would have shown.
    sets : SetSettings
        Which sets of effects are compared where something remains ...
    sure_effects : int
        ... or where more than this many effects are found.
    laws : LawSettings
        How laws are looked for in what known effects leave unexplained.
    learned : LearnedSettings
        How forces are learned from what laws leave unexplained too.
    wiring : WiringSettings or None
        When signs, units and places of columns are wrong: that is the finding then, and nothing
        else is looked for. Never if None.
    far_off : FarOffLimits or None
        From when on the search is that for models that are far off; never if None.
    regression : QuickSettings
        How they are found.
    motions : FarOffSettings
        How they are fitted to whole motions.
    longest : int
        Control steps at most of the windows by which such a model is evaluated ...
    evaluated : int
        ... and about how many there are on each side ...
    exactly : int
        ... or, where more exact physics steps are taken, which cost several times as much.
    each : HeldOutSettings
        The windows that say whether such a model predicts as well without one of its many effects.
    """

    windows: int = 96
    long_windows: int = 48
    wiring: WiringSettings | None = field(default_factory=WiringSettings)
    far_off: FarOffLimits | None = field(default_factory=FarOffLimits)
    regression: QuickSettings = field(default_factory=QuickSettings)
    motions: FarOffSettings = field(default_factory=FarOffSettings)
    longest: int = 50
    evaluated: int = 48
    exactly: int = 24
    each: HeldOutSettings = field(default_factory=lambda: EACH)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    window_length: WindowLengthSettings = field(default_factory=WindowLengthSettings)
    noise: WhitenessSettings = field(default_factory=WhitenessSettings)
    horizons: EveryHorizonSettings = field(default_factory=EveryHorizonSettings)
    nothing: float = 0.98
    detectable: DetectableSettings = field(default_factory=DetectableSettings)
    sets: SetSettings = field(default_factory=SetSettings)
    sure_effects: int = 2
    laws: LawSettings = field(default_factory=LawSettings)
    learned: LearnedSettings = field(default_factory=LearnedSettings)
