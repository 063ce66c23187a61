"""Worlds from drawings in SVG, as Inkscape and others write them (extra ``plans``)."""

import math
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.worlds.formats.drawings import (
    MAX_DRAWING_BYTES,
    MAX_ELEMENTS,
    TOLERANCE,
    Stroke,
    drawn_world,
    unit_of,
)
from limslam_env.worlds.formats.pictures import path_name
from limslam_env.worlds.formats.tables import read_text
from limslam_env.worlds.world import MAX_EDGES, World, WorldError, named

_GROUPS = frozenset(("svg", "g", "a", "switch", "symbol"))
_SHAPES = frozenset(("line", "polyline", "polygon", "rect", "circle", "ellipse", "path"))
_SIZES = ("x", "y", "width", "height", "x1", "y1", "x2", "y2", "cx", "cy", "r", "rx", "ry")
_LABEL = "{http://www.inkscape.org/namespaces/inkscape}label"
_LINK = "{http://www.w3.org/1999/xlink}href"
_LOOKS = ("display", "visibility", "fill", "stroke")
_WHITE = frozenset(("none", "white", "#fff", "#ffffff", "transparent", "rgb(255,255,255)"))

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_LENGTH = re.compile(rf"\s*({_NUMBER.pattern})\s*([a-z]*)\s*")
_CLASS = re.compile(r"\.([\w-]+)[^{}]*\{([^{}]*)\}")
# Metres of a unit of length, and pixels of the same: CSS has 96 of them in an inch.
_METRES = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6}
_PIXEL = 0.0254 / 96

_DEEPEST = 60  # groups within groups
_LONGEST_PATHS = 2_000_000  # letters: more are far more lines than a world has


def read_svg(
    path: Path, metres_per_unit: float | None, wall_layers: tuple[str, ...] | None
) -> World:
    """The world in an SVG file; ``metres_per_unit`` and ``wall_layers`` as for :func:`unit_of` and
    :func:`drawn_world`.

    Lines, polylines, polygons, rectangles, circles, ellipses and paths are read. Groups are layers
    by their labels in Inkscape, or else by their ids. What is not shown is not read, nor is a white
    area without a line around it. A physical width, such as 8000 mm, gives the unit. A WorldError
    says why the file cannot be used, or that svgpathtools is not installed.
    """
    with named(path):
        try:
            import svgpathtools  # noqa: F401 - asked for before the file is read
        except ImportError as error:
            raise WorldError(
                'an .svg is read with svgpathtools: pip install "limslam[plans]"'
            ) from error
        root = _root(read_text(path, MAX_DRAWING_BYTES))
        unit = unit_of(metres_per_unit, _physical_unit(root))
        return drawn_world(
            path_name(path),
            _Drawing(root, unit).strokes(),
            wall_layers,
            is_unit_sure=metres_per_unit is not None,
        )


def _root(text: str) -> ET.Element:
    try:
        # Expat itself limits what entities may expand to, and loads nothing from outside.
        root = ET.fromstring(text)  # noqa: S314
    except (ET.ParseError, ValueError, RecursionError) as error:
        raise WorldError(f"not SVG: {error}") from error
    if _tag(root) != "svg":
        raise WorldError("not SVG: it is another kind of XML")
    return root


def _tag(element: ET.Element) -> str:
    # Comments have a function in place of a name.
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""


def _length(text: str) -> tuple[float, str]:
    """A number and its unit; a WorldError where there is none."""
    found = _LENGTH.fullmatch(text)
    if found is None:
        raise WorldError(f"{text[:60]!r} is no length")
    return float(found[1]), found[2]


def _physical_unit(root: ET.Element) -> float | None:
    """Metres of a unit of the drawing, where its width is given in mm or the like."""
    text = root.get("width", "")
    if not any(text.strip().endswith(name) for name in _METRES):
        return None
    width, name = _length(text)
    view = [float(number) for number in _NUMBER.findall(root.get("viewBox", ""))]
    if len(view) != 4 or not view[2] > 0.0 or not width > 0.0:
        return _PIXEL
    return width * _METRES[name] / view[2]


@dataclass(frozen=True, eq=False)
class _Place:
    """Where an element is: the transformation (3, 3) to the drawing, layers, looks, and depth."""

    transform: FloatArray
    layers: tuple[str, ...]
    looks: Mapping[str, str]
    depth: int


class _Drawing:
    """A walk through an SVG file, whose unit is ``unit``, m."""

    def __init__(self, root: ET.Element, unit: float) -> None:
        self._root = root
        self._scale = np.diag([unit, -unit, 1.0])
        self._by_id = {element.get("id"): element for element in root.iter()}
        sheets = "".join(sheet.text or "" for sheet in root.iter() if _tag(sheet) == "style")
        self._classes = {name: _declared(style) for name, style in _CLASS.findall(sheets)}
        self._count = 0
        self._letters = 0

    def strokes(self) -> Iterator[Stroke]:
        """The strokes of all shapes that are shown."""
        for element in self._root:
            yield from self._within(element, _Place(self._scale, (), {}, 0))

    def _within(self, element: ET.Element, place: _Place) -> Iterator[Stroke]:
        self._count += 1
        if self._count > MAX_ELEMENTS:
            raise WorldError(f"more than {MAX_ELEMENTS} elements: save the layers of walls only")
        if place.depth > _DEEPEST:
            raise WorldError(f"groups within groups are more than {_DEEPEST} deep")
        tag = _tag(element)
        if tag not in _GROUPS and tag not in _SHAPES and tag != "use":
            return
        inner = self._inner(element, place)
        if inner.looks.get("display") == "none":
            return
        if tag == "use":
            link = element.get("href") or element.get(_LINK) or ""
            target = self._by_id.get(link.removeprefix("#"))
            if target is not None:
                yield from self._within(target, inner)
        elif tag in _GROUPS:
            for child in element:
                yield from self._within(child, inner)
        elif _is_seen(inner.looks) and not any("%" in element.get(key, "") for key in _SIZES):
            yield from self._strokes_of(tag, element, inner)

    def _inner(self, element: ET.Element, place: _Place) -> _Place:
        from svgpathtools.parser import parse_transform

        looks = {name: element.attrib.get(name, "") for name in _LOOKS}
        for name in element.get("class", "").split():
            looks |= self._classes.get(name, {})
        looks |= _declared(element.get("style", ""))
        looks = {name: value for name, value in looks.items() if value not in {"", "inherit"}}
        try:
            # The library warns about a part of a transformation that it does not know.
            with warnings.catch_warnings(action="error"):
                own = parse_transform(element.get("transform", ""))
        except (ValueError, IndexError, TypeError, Warning) as error:
            raise WorldError(f"no transformation: {element.get('transform')!r}") from error
        transform = place.transform @ own
        if _tag(element) == "use":
            shift = np.eye(3)
            shift[:2, 2] = [_pixels(element.get(key, "0")) for key in ("x", "y")]
            transform = transform @ shift
        layer = element.get(_LABEL) or element.get("id")
        layers = (*place.layers, layer) if layer else place.layers
        return _Place(transform, layers, {**place.looks, **looks}, place.depth + 1)

    def _strokes_of(self, tag: str, element: ET.Element, place: _Place) -> Iterator[Stroke]:
        from svgpathtools import parse_path

        text = _path_of(tag, element)
        self._letters += len(text)
        if self._letters > _LONGEST_PATHS:
            raise WorldError(f"more than {MAX_EDGES} lines: save the layers of walls only")
        try:
            # A warning says that an arc without a radius is a line, which it is.
            with warnings.catch_warnings(action="ignore"):
                segments = parse_path(text)
        except (ValueError, IndexError, TypeError, ArithmeticError, AssertionError) as error:
            raise WorldError(f"{tag} {element.get('id', '')!r} cannot be read: {error}") from error
        if any(segment.end is None for segment in segments):
            raise WorldError(f"{tag} {element.get('id', '')!r}: a path begins with M")
        scale = float(np.linalg.norm(place.transform[:2, :2], 2))
        runs: list[list[complex]] = []
        for segment in segments:
            if not runs or segment.start != runs[-1][-1]:
                runs.append([segment.start])
            runs[-1] += _points_after_start(segment, scale)
        for run in runs:
            points = np.array(run)
            corners = np.column_stack((points.real, points.imag, np.ones(len(points))))
            yield Stroke((corners @ place.transform.T)[:, :2], place.layers)


def _declared(style: str) -> dict[str, str]:
    """The looks that a style, such as ``fill:none;stroke:#000``, declares."""
    pairs = (part.split(":", 1) for part in style.split(";") if ":" in part)
    found = {name.strip(): value.strip() for name, value in pairs}
    return {name: value for name, value in found.items() if name in _LOOKS}


def _is_seen(looks: Mapping[str, str]) -> bool:
    """Whether a shape has a line around it, or an area that is not white."""
    if looks.get("visibility") in {"hidden", "collapse"}:
        return False
    if looks.get("stroke", "none") not in {"none", "transparent"}:
        return True
    return looks.get("fill", "black").lower().replace(" ", "") not in _WHITE


def _pixels(text: str) -> float:
    """A length in units of the drawing."""
    number, name = _length(text)
    return number * _METRES.get(name, _PIXEL) / _PIXEL


def _path_of(tag: str, element: ET.Element) -> str:
    """The outline of a shape as a path of SVG; empty where the shape has no size."""
    if tag == "path":
        return element.get("d", "")
    if tag in {"polyline", "polygon"}:
        numbers = _NUMBER.findall(element.get("points", ""))
        pairs = [f"{x} {y}" for x, y in zip(numbers[::2], numbers[1::2], strict=False)]
        close = "Z" if tag == "polygon" else ""
        return f"M{' L'.join(pairs)}{close}" if len(pairs) > 1 else ""
    size = {key: _pixels(element.get(key, "0")) for key in _SIZES}
    if tag == "line":
        return f"M{size['x1']} {size['y1']} L{size['x2']} {size['y2']}"
    if tag == "rect":
        x, y, width, height = (size[key] for key in ("x", "y", "width", "height"))
        return f"M{x} {y} h{width} v{height} h{-width} Z" if width > 0 and height > 0 else ""
    rx, ry = (size["r"], size["r"]) if tag == "circle" else (size["rx"], size["ry"])
    half = f"a{rx} {ry} 0 1 0"
    start = f"M{size['cx'] - rx} {size['cy']}"
    return f"{start} {half} {2 * rx} 0 {half} {-2 * rx} 0" if rx > 0 and ry > 0 else ""


def _points_after_start(segment: Any, scale: float) -> list[complex]:
    """Points along a segment of a path, without its start, that no more than the tolerance (m)
    lies beyond; ``scale`` is the largest length (m) of a unit.

    A piece of a curve in n equal steps of its parameter lies within max |b''| / (8 n^2) of its
    chords.
    """
    if hasattr(segment, "delta"):  # an arc; delta is its angle in degrees
        bend = max(abs(segment.radius.real), abs(segment.radius.imag))
        bend *= math.radians(segment.delta) ** 2
    else:
        points = np.array(segment.bpoints())
        degree = len(points) - 1
        bends = np.abs(points[2:] - 2.0 * points[1:-1] + points[:-2])
        bend = degree * (degree - 1) * float(bends.max(initial=0.0))
    count = math.sqrt(bend * scale / (8.0 * TOLERANCE))
    if not count <= MAX_EDGES:
        raise WorldError("it holds a number that is too large")
    steps = max(math.ceil(count), 1)
    inner = [complex(segment.point(step / steps)) for step in range(1, steps)]
    return [*inner, segment.end]
