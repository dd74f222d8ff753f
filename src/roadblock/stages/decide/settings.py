"""What can be set about deciding."""

from functools import cached_property

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from roadblock.values.checks import FloatArray


class DecideSettings(BaseModel):
    """The car, what it can do, and when something is done."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    enabled: bool = Field(False, description="Whether anything is decided at all (only where frames are tracked).")
    width_m: float = Field(1.7, gt=0, description="Width of the car.")
    front_m: float = Field(1.3, description="How far its front is ahead of the cameras, ...")
    rear_m: float = Field(2.8, gt=0, description="... and its rear behind them.")
    delay_s: float = Field(0.3, ge=0, description="From a picture until brakes and steering act.")
    brake_mps2: float = Field(6.0, gt=0, description="Hardest braking.")
    lateral_mps2: float = Field(3.0, gt=0, description="Hardest steering.")
    turn_m: float = Field(6.0, gt=0, description="Smallest turning circle, its radius.")
    margin_m: float = Field(0.4, ge=0, description="Room at each side of a way round; half of it must always be free.")
    stop_m: float = Field(4.0, ge=0, description="Room left before what it stops for, to drive round it afterwards.")
    warn_s: float = Field(2.5, gt=0, description="A shorter time to contact is warned of.")
    swerve_s: float = Field(2.5, gt=0, description="Swerving round something begins below this.")
    brake_share: float = Field(0.6, gt=0, le=1, description="Braking begins when this share of `brake_mps2` is needed.")
    confirm: int = Field(2, ge=1, description="So many frames, of one more, must agree before anything is done.")
    hold_s: float = Field(0.3, ge=0, description="So long it goes on after the road was free again.")
    widest_m: float = Field(4.0, gt=0, description="No swerve leads further aside than this from the car's old line.")

    @cached_property
    def numbers(self) -> FloatArray:
        """(7,) what kernels need: front, rear, width, hardest braking, the share of it, room to stop, delay."""
        return np.array(
            [self.front_m, self.rear_m, self.width_m, self.brake_mps2, self.brake_share, self.stop_m, self.delay_s]
        )
