"""What a policy's JSON file must hold."""

from typing import Annotated, Any, Literal

from pydantic import Field

from dropo.core.services.files.file_schema import Saved

Row = Annotated[list[float], Field(min_length=1)]
Ends = list[float | None]
Positive = Annotated[float, Field(gt=0)]


class SavedAbout(Saved):
    """How a policy was trained."""

    steps: Annotated[int, Field(ge=1)] | None = None


class SavedPolicy(Saved):
    """What every policy has."""

    kind: Literal["linear", "network"]
    limits: Annotated[list[Ends], Field(min_length=2, max_length=2)]
    about: SavedAbout
    version: str = ""


class SavedLinearPolicy(SavedPolicy):
    """A linear policy on normalised observations."""

    weights: Annotated[list[Row], Field(min_length=1)]
    mean: Row
    deviation: Annotated[list[Positive], Field(min_length=1)]


class SavedScale(Saved):
    """By what observations are normalised."""

    mean: Row
    deviation: Annotated[list[Positive], Field(min_length=1)]


class SavedNetworkPolicy(SavedPolicy):
    """A network of stable-baselines3, whose zip is beside the file."""

    algorithm: Literal["sac", "ppo"]
    scale: SavedScale | None


SCHEMAS: dict[Any, type[SavedPolicy]] = {
    "linear": SavedLinearPolicy,
    "network": SavedNetworkPolicy,
}
"""By kind."""
