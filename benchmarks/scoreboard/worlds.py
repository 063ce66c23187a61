"""The worlds of rows: those of suites, and kinds of rooms that floor plans seldom have, by a kind
and a seed.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.suite.runner import world_source
from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import polygon_edges
from limslam_env.interface import RobotSpec
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

_PILLARS = FloorPlanConfig(obstacles=6.0, obstacle_size=(0.2, 0.35), slanted=0.0)
_TABLES = FloorPlanConfig(obstacles=2.5, obstacle_size=(0.8, 1.5), slanted=0.0, min_room=2.5)
_HALLS = FloorPlanConfig(
    width=(12.0, 16.0), height=(8.0, 11.0), min_room=5.0, corridor=0.3, obstacles=0.2
)
# m: thickness of a table's leg, and from the table's edge to it
_LEG = 0.04
_OVERHANG = 0.08
_FACETS = 48
# m, of a round room
_LEAST_RADIUS = 2.2
_LARGEST_RADIUS = 3.2


def _pillars(generator: np.random.Generator) -> World:
    """A floor plan with many pillars."""
    return floor_plan(_PILLARS, generator, RobotSpec().radius)


def _halls(generator: np.random.Generator) -> World:
    """A floor plan of a few halls, most of which the beams cannot see at once."""
    return floor_plan(_HALLS, generator, RobotSpec().radius)


def _tables(generator: np.random.Generator) -> World:
    """A floor plan with tables, of which the beams see the legs."""
    plan = floor_plan(_TABLES, generator, RobotSpec().radius)
    legs = tuple(leg for table in plan.obstacles for leg in _legs(table))
    return replace(plan, obstacles=legs)


def _legs(table: FloatArray) -> list[FloatArray]:
    """Three or four square legs (4, 2), m, below the corners of a table (k, 2)."""
    inwards = table.mean(axis=0) - table
    feet = table + _OVERHANG * inwards / np.hypot(*inwards.T)[:, None]
    chosen = np.unique(np.linspace(0, len(feet), 4, endpoint=False).astype(int))
    square = 0.5 * _LEG * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return [foot + square for foot in feet[chosen]]


def _round(generator: np.random.Generator) -> World:
    """A round room of many facets, with nothing in it."""
    radius = generator.uniform(_LEAST_RADIUS, _LARGEST_RADIUS)
    turns = 2.0 * np.pi * (np.arange(_FACETS) + generator.random()) / _FACETS
    side = 2.0 * radius + 1.0
    corners = 0.5 * side + radius * np.column_stack((np.cos(turns), np.sin(turns)))
    return World("round", (side, side), polygon_edges(corners))


_KINDS: dict[str, Callable[[np.random.Generator], World]] = {
    "pillars": _pillars,
    "halls": _halls,
    "tables": _tables,
    "round": _round,
}


def world_of(name: str) -> World:
    """The world of a cell, by its name: ``round:17``, for example, or a name that suites know."""
    kind, _, seed = name.partition(":")
    if kind not in _KINDS:
        return load_world(world_source(name))
    return replace(_KINDS[kind](np.random.default_rng(int(seed))), name=name)
