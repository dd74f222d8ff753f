"""The public schema of `obstacles.jsonl`, version 1: one `FrameRecord` per line; unknown is null, never NaN."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

SCHEMA = 1
"""Version of the records; a reader refuses every other one."""

Pair = Annotated[list[float], Field(min_length=2, max_length=2)]
Triple = Annotated[list[float], Field(min_length=3, max_length=3)]
Box = Annotated[list[int], Field(min_length=4, max_length=4)]
Pixel = Annotated[list[int], Field(min_length=2, max_length=2)]


class Record(BaseModel):
    """Strict: no text where a number belongs, no NaN; fields that a later version adds are let through."""

    model_config = ConfigDict(strict=True, allow_inf_nan=False, frozen=True)


class ObstacleRecord(Record):
    """One obstacle; see `roadblock.values.scene.Obstacle` for what each number means."""

    id: int | None
    class_: str = Field(alias="class")
    class_probability: float | None
    color: str | None
    position_m: Triple
    range_m: float
    range_sigma_m: float | None
    range_sigma_calib_m: float | None = None
    cov_calib_m2: Annotated[list[Triple], Field(min_length=3, max_length=3)] | None = None
    size_m: Annotated[list[float | None], Field(min_length=3, max_length=3)]
    box_px: Box
    contour_px: list[Pixel]
    seen_through: bool = False
    velocity_mps: Triple | None
    ttc_s: float | None
    age_s: float | None = None
    coasted_s: float | None = None
    motion: Literal["moving", "standing", "unknown"] | None = None
    velocity_sigma_mps: Pair | None = None
    velocity_over_ground: bool | None = None
    ttc_sigma_s: float | None = None
    class_odds: dict[str, float] = {}
    colors: list[str] = []
    color_lab: Triple | None = None
    size_sigma_m: Annotated[list[float | None], Field(min_length=3, max_length=3)] | None = None
    outline_m: list[Pair] = []
    heading_rad: float | None = None
    heading_sigma_rad: float | None = None


class RoadEdgesRecord(Record):
    """Per image column the first kerb or verge before the end of the free space, null where none was seen."""

    range_m: list[float | None]
    height_m: list[float | None]
    kind: list[Literal["kerb", "verge"] | None]


class FreeSpaceRecord(Record):
    """Per image column the forward distance to the first thing on the road, null where unobserved."""

    u_px: list[float]
    range_m: list[float | None]
    blocked: list[bool] | None = None
    edges: RoadEdgesRecord | None = None


class GroundRecord(Record):
    """The road seen from the point halfway between the cameras."""

    height_m: float
    pitch_rad: float
    roll_rad: float


class HealthRecord(Record):
    """Whether the frame can be trusted, and why not."""

    state: str
    reasons: list[str]


class StixelsRecord(Record):
    """What stands, column by column: middle, rows (half open), range, and height of the top over the road."""

    u_px: list[float]
    top_px: list[float]
    bottom_px: list[float]
    range_m: list[float]
    height_m: list[float | None]


class DecisionRecord(Record):
    """What the car should do; see `roadblock.values.decision.Decision`."""

    action: Literal["none", "warn", "brake", "swerve"]
    reason: str
    ttc_s: float | None
    ttc_sigma_s: float | None
    deceleration_mps2: float
    curvature_per_m: float
    offset_m: float
    obstacle_id: int | None


class FrameRecord(Record):
    """One line of `obstacles.jsonl`."""

    schema_: Literal[1] = Field(alias="schema")
    frame: int
    name: str
    t_ns: int
    obstacles: list[ObstacleRecord]
    free_space: FreeSpaceRecord
    ground: GroundRecord | None
    health: HealthRecord
    timings_ms: dict[str, float | None]
    stixels: StixelsRecord | None = None
    decision: DecisionRecord | None = None
