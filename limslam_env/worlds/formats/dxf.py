"""Worlds from drawings in DXF, as CAD programs write them (extra ``plans``)."""

import logging
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.worlds.formats.drawings import (
    MAX_DRAWING_BYTES,
    MAX_ELEMENTS,
    TOLERANCE,
    Stroke,
    drawn_world,
    unit_of,
)
from limslam_env.worlds.formats.pictures import path_name
from limslam_env.worlds.formats.tables import read_bytes
from limslam_env.worlds.world import MAX_EDGES, World, WorldError, named

# What ezdxf mends in a drawing is of no use on a user's screen.
logging.getLogger("ezdxf").addHandler(logging.NullHandler())

_LINES = frozenset(
    ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "SOLID", "TRACE")
)
_COMPOSED = frozenset(("INSERT", "MLINE"))
_DEEPEST = 20  # blocks within blocks


def read_dxf(
    path: Path, metres_per_unit: float | None, wall_layers: tuple[str, ...] | None
) -> World:
    """The world in the model space of a DXF file; ``metres_per_unit`` and ``wall_layers`` as for
    :func:`unit_of` and :func:`drawn_world`.

    Lines, multilines, polylines, arcs, circles, ellipses, splines and solids are read, also those
    of blocks.
    Layers that are off or frozen are not. A WorldError says why the file cannot be used, or that
    ezdxf is not installed.
    """
    with named(path):
        try:
            from ezdxf.enums import InsertUnits
            from ezdxf.filemanagement import readfile
            from ezdxf.units import conversion_factor
        except ImportError as error:
            raise WorldError('a .dxf is read with ezdxf: pip install "limslam[plans]"') from error
        if len(read_bytes(path, MAX_DRAWING_BYTES + 1)) > MAX_DRAWING_BYTES:
            raise WorldError(
                f"larger than {MAX_DRAWING_BYTES / 1e6:g} MB: save the layers of walls only"
            )
        try:
            document = readfile(path)
            kind = InsertUnits(document.units)
            from_file = conversion_factor(kind, InsertUnits.Meters) if kind else None
            unit = unit_of(metres_per_unit, from_file)
            strokes = _strokes(document, unit)
            return drawn_world(
                path_name(path), strokes, wall_layers, is_unit_sure=metres_per_unit is not None
            )
        # Damaged drawings raise errors of many types: those of ezdxf, ValueError, TypeError, ...
        except Exception as error:
            if isinstance(error, WorldError):
                raise
            raise WorldError(f"cannot be read: {str(error) or type(error).__name__}") from error


def _strokes(document: Any, unit: float) -> Iterator[Stroke]:
    from ezdxf.path import make_path

    hidden = {
        layer.dxf.name.casefold()
        for layer in document.layers
        if layer.is_off() or layer.is_frozen()
    }
    for count, (entity, layer) in enumerate(_entities(document.modelspace(), None, 0)):
        if count >= MAX_ELEMENTS:
            raise WorldError(f"more than {MAX_ELEMENTS} elements: save the layers of walls only")
        if entity.dxftype() not in _LINES or layer.casefold() in hidden:
            continue
        path = make_path(entity)
        for part in path.sub_paths():
            points = islice(part.flattening(TOLERANCE / unit), MAX_EDGES + 2)
            corners = [(point.x, point.y) for point in points]
            yield Stroke(np.array(corners).reshape(-1, 2) * unit, (layer,))


def _entities(entities: Any, around: str | None, depth: int) -> Iterator[tuple[Any, str]]:
    """The entities, those of blocks where the blocks are inserted, each with its layer.

    What is in layer 0 of a block is in the layer of the block.
    """
    for entity in entities:
        own = entity.dxf.get("layer", "0")
        layer = around if around is not None and own == "0" else own
        yield entity, layer
        if entity.dxftype() not in _COMPOSED:
            continue
        if depth == _DEEPEST:
            raise WorldError(f"blocks within blocks are more than {_DEEPEST} deep")
        for part in entity.multi_insert() if entity.dxftype() == "INSERT" else (entity,):
            yield from _entities(part.virtual_entities(), layer, depth + 1)
