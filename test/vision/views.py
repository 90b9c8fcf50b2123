"""Rendered views of boards for the tests of vision."""

import functools

import numpy as np

from slot_core.geometry import Transform, optical
from slot_core.vision.board import make_board, print_of
from slot_core.vision.camera import nominal
from slot_core.vision.settings import read_vision
from slot_core.vision.synthetic_camera import (
    Imperfections,
    Surface,
    SyntheticCamera,
)

VISION = read_vision()
CAMERA = nominal(VISION.camera)
# camera_link in base_link
MOUNT = Transform.of((0.06, 0.0, 0.03), (0.0, 0.0, 0.0))


@functools.cache
def synthetic(**made):
    """A synthetic camera; its images depend on those before it only in the noise."""
    return SyntheticCamera(
        CAMERA, Imperfections(**made), np.random.default_rng(0)
    )


def board(name, settings=None):
    return make_board((settings or VISION).boards[name])


def seen_from_torso(base, name="wall"):
    """Pose of a board in the world in the camera on the torso."""
    return optical(base @ MOUNT).inverse @ board(name).pose


def image_from_torso(base, name="wall", settings=None, **made):
    """Image of the camera on the torso at `base`."""
    vision = settings or VISION
    shown = board(name, vision)
    corners = seen_from_torso(base, name).apply(shown.outline)
    sheet = print_of(shown, vision.dictionary_number)
    return synthetic(**made).image([Surface(sheet, corners)])
