"""Named conditions: a camera as it is used, and the weather before it."""

import math
from dataclasses import dataclass, field, replace
from difflib import get_close_matches

from roadblock.errors import SettingsError
from roadblock.sim.sensor import Sensor
from roadblock.sim.weather import Weather


@dataclass(frozen=True)
class Effects:
    """All that happens between the clear, bright world and the image.

    Attributes
    ----------
    sensor
        The cameras; by default perfect ones.
    weather
        The day; by default clear.
    """

    sensor: Sensor = field(default_factory=Sensor)
    weather: Weather = field(default_factory=Weather)


CAMERA = Sensor(
    exposure=None,
    psf_px=0.45,
    vignetting=2.0,
    full_well_e=10_000.0,
    read_noise=0.8,
    gain=(1.0, 1.015),
    offset=(0.0, 0.5),
)
"""A fair machine-vision camera: noise about 1.5 grey levels, gains 1.5 % apart."""

DAY = Effects(CAMERA)

CONDITIONS: dict[str, Effects] = {
    "day": DAY,
    "dusk": replace(DAY, weather=Weather(daylight=(1.0e-3, 0.9e-3, 1.2e-3), head_lamps=4e-4)),
    "night": replace(DAY, weather=Weather(daylight=(5e-5, 6e-5, 9e-5), head_lamps=1.2e-3, street_lamps=1.5e-3)),
    "rain": replace(DAY, weather=Weather(daylight=(0.3, 0.31, 0.33), rain_mm_h=25.0, wetness=0.8, lens_drops=14)),
    "fog": replace(DAY, weather=Weather(daylight=(0.5, 0.5, 0.5), visibility_m=60.0)),
    "wet": replace(DAY, weather=Weather(wetness=1.0)),
    "dirty": replace(DAY, weather=Weather(dirt=0.85)),
}
"""Conditions by name; several are combined by `combined`."""


def combined(names: tuple[str, ...]) -> Effects:
    """Return the conditions of these names together: what each changes against "day".

    Light multiplies (rain at night is darker still); of all else, the stronger counts.

    Raises
    ------
    SettingsError
        If there is no such condition.
    """
    for name in names:
        if name not in CONDITIONS:
            near = get_close_matches(name, CONDITIONS, 1)
            hint = f"did you mean {near[0]}?" if near else "choose one of these"
            raise SettingsError(f"{name!r:.40} is no condition; {hint} ({', '.join(CONDITIONS)})")
    weathers = [CONDITIONS[name].weather for name in dict.fromkeys(names)]
    if not weathers:
        return DAY
    red, green, blue = (math.prod(channel) for channel in zip(*(w.daylight for w in weathers), strict=True))
    return replace(
        DAY,
        weather=Weather(
            daylight=(red, green, blue),
            head_lamps=max(w.head_lamps for w in weathers),
            street_lamps=max(w.street_lamps for w in weathers),
            visibility_m=min(w.visibility_m for w in weathers),
            rain_mm_h=max(w.rain_mm_h for w in weathers),
            wetness=max(w.wetness for w in weathers),
            lens_drops=max(w.lens_drops for w in weathers),
            dirt=max(w.dirt for w in weathers),
        ),
    )
