"""Things with their real outlines and sizes, and tables of them by type and by colour."""

from roadblock.sim.things.bikes import bicycle, cyclist
from roadblock.sim.things.catalog import TYPES, Order, build
from roadblock.sim.things.colors import COLORS, shaded
from roadblock.sim.things.people import person
from roadblock.sim.things.scenery import bridge, house, tree
from roadblock.sim.things.street import (
    SIGNS,
    carton,
    crate,
    fork,
    hedge,
    pole,
    railing,
    sign,
    stone,
    street_lamp,
    traffic_cone,
    tyre,
    wall,
)
from roadblock.sim.things.vehicles import CARS, car, truck, van

__all__ = [
    "CARS",
    "COLORS",
    "SIGNS",
    "TYPES",
    "Order",
    "bicycle",
    "bridge",
    "build",
    "car",
    "carton",
    "crate",
    "cyclist",
    "fork",
    "hedge",
    "house",
    "person",
    "pole",
    "railing",
    "shaded",
    "sign",
    "stone",
    "street_lamp",
    "traffic_cone",
    "tree",
    "truck",
    "tyre",
    "van",
    "wall",
]
