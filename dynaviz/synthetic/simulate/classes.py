"""Classes of simulated points.

The subset of SemanticKITTI's numbers and names that the scenes use.
"""

from __future__ import annotations

from enum import IntEnum


class ObjectClass(IntEnum):
    """Class of a point. Classes from 252 on move; their points are dynamic in every scan."""

    OUTLIER = 1  # multipath return, below the ground
    MIXED_PIXEL = 2  # between two static surfaces
    CAR = 10
    PARKED_BICYCLE = 11
    ROAD = 40
    SIDEWALK = 48
    OTHER_GROUND = 49
    BUILDING = 50
    FENCE = 51
    OTHER_STRUCTURE = 52
    VEGETATION = 70
    TRUNK = 71
    TERRAIN = 72
    POLE = 80
    TRAFFIC_SIGN = 81
    OTHER_OBJECT = 99
    MOVING_CAR = 252
    MOVING_BICYCLIST = 253
    MOVING_PERSON = 254
    MOVING_TRUCK = 258
    MOVING_OTHER_VEHICLE = 259
    MOVING_MIXED_PIXEL = 260  # between a mover and another surface
    MOVING_OUTLIER = 261  # multipath return of a mover, below the ground
    AIRBORNE = 262  # rain or dust
    MOVING_ANIMAL = 263
    MOVING_DOOR = 264


CLASS_NAMES = {
    int(kind): kind.name.lower().replace("parked_", "").replace("_", " ") for kind in ObjectClass
}

BY_EFFECTS = (
    ObjectClass.MIXED_PIXEL,
    *(kind for kind in ObjectClass if kind >= ObjectClass.MOVING_MIXED_PIXEL),
)
"""Classes that only effects produce."""

REFLECTANCE = {
    ObjectClass.ROAD: 0.2,
    ObjectClass.SIDEWALK: 0.3,
    ObjectClass.OTHER_GROUND: 0.3,
    ObjectClass.BUILDING: 0.5,
    ObjectClass.VEGETATION: 0.6,
    ObjectClass.TRUNK: 0.3,
    ObjectClass.TERRAIN: 0.4,
    ObjectClass.TRAFFIC_SIGN: 1.0,
}
"""Reflectance by class, 0 to 1; other objects define their own or have 0.4."""
