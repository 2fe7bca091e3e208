"""How colours look to people with and without colour blindness."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from dynaviz.colours import Colour

# Protanopia, deuteranopia and tritanopia at full strength, on linear RGB (Machado, Oliveira and
# Fernandes 2009).
EYES = {
    "common": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}


def smallest_difference(colours: Iterable[Colour], eye: str) -> float:
    """Distance of the two most similar colours in CIE L*a*b*; 2.3 is just noticeable."""
    seen = [_lab(_seen(colour, eye)) for colour in colours]
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2))


def contrast(a: Colour, b: Colour, eye: str) -> float:
    """Ratio of the luminances of two colours as in WCAG 2, 1 to 21; 3 is required of figures."""
    dark, light = sorted(float(_seen(colour, eye) @ [0.2126, 0.7152, 0.0722]) for colour in (a, b))
    return (light + 0.05) / (dark + 0.05)


def _seen(colour: Colour, eye: str) -> np.ndarray:
    """Linear sRGB as an eye sees it, 0 to 1."""
    return np.clip(np.array(EYES[eye]) @ _linear(colour), 0, 1)


def _linear(colour: Colour) -> np.ndarray:
    c = np.array(colour) / 255
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def _lab(rgb: np.ndarray) -> np.ndarray:
    """CIE L*a*b* of linear sRGB."""
    xyz = (
        np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
        @ rgb
    )
    x, y, z = np.cbrt(xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])
