"""Stretches of faces where free ground ends."""

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_SLIGHTLY_MORE = 1.0 + 1e-9


@compiled
def are_near(middles: FloatArray, first: int, second: int, reach: float) -> bool:
    """Whether two of the points (n, 2) are at most so far apart."""
    x = middles[first, 0] - middles[second, 0]
    y = middles[first, 1] - middles[second, 1]
    return bool(x * x + y * y <= reach * reach)


@compiled
def cosine(normals: FloatArray, first: int, second: int) -> float:
    """Cosine of the angle between two of the unit vectors (n, 2)."""
    return float(normals[first, 0] * normals[second, 0] + normals[first, 1] * normals[second, 1])


@lean_entry
def sum_normals(
    middles: FloatArray, normals: FloatArray, order: IntArray, reach: float, total: FloatArray
) -> None:
    """Add to the normal of each face (n, 2) those of the faces near it that do not look the
    opposite way.

    ``total`` (n, 2) holds the normals before, and ``reach`` is how far apart the middles (n, 2) may
    be. ``order`` (n,) sorts the middles by y.
    """
    for place in range(len(order)):
        i = order[place]
        for j in order[:place][::-1]:
            if middles[i, 1] - middles[j, 1] > _SLIGHTLY_MORE * reach:
                break
            if are_near(middles, i, j, reach) and cosine(normals, i, j) >= 0.0:
                for k in range(2):
                    total[i, k] += normals[j, k]
                    total[j, k] += normals[i, k]


@compiled
def stretch_of(stretches: IntArray, face: int) -> int:
    """The first face of the stretch of a face, as far as the stretch is known."""
    while stretches[face] != face:
        stretches[face] = stretches[stretches[face]]
        face = stretches[face]
    return face


@lean_entry
def join_faces(
    middles: FloatArray,
    normals: FloatArray,
    order: IntArray,
    reach: float,
    least: float,
    stretches: IntArray,
) -> None:
    """Join faces to stretches: those at most ``reach`` apart between whose normals the cosine is at
    least ``least``.

    ``order`` (n,) sorts the middles by y. ``stretches`` (n,) is set to the index of one face of
    each face's stretch.
    """
    for place in range(len(order)):
        i = order[place]
        stretches[i] = i
        for j in order[:place][::-1]:
            if middles[i, 1] - middles[j, 1] > _SLIGHTLY_MORE * reach:
                break
            if are_near(middles, i, j, reach) and cosine(normals, i, j) >= least:
                first = stretch_of(stretches, i)
                second = stretch_of(stretches, j)
                stretches[max(first, second)] = min(first, second)
    for i in range(len(middles)):
        stretches[i] = stretch_of(stretches, i)


@lean_entry
def mark_drawn(
    middles: FloatArray,
    normals: FloatArray,
    walls: FloatArray,
    across: float,
    sideways: float,
    past: float,
    same_way: float,
    drawn: BoolArray,
) -> None:
    """Set which faces (n,), with these middles, m, and normals (n, 2), have a wall drawn at them.

    Each of the walls (m, 5) has its start, m, unit vector along it, and length, m. A face that
    looks along a wall's normal, by a cosine of at least ``same_way``, may be ``across`` away from
    it, m, and any other face ``sideways``; past the wall's ends, ``past``.
    """
    for i in range(len(middles)):
        drawn[i] = False
        for wall in range(len(walls)):
            x = middles[i, 0] - walls[wall, 0]
            y = middles[i, 1] - walls[wall, 1]
            along_x = walls[wall, 2]
            along_y = walls[wall, 3]
            length = walls[wall, 4]
            looks = abs(normals[i, 0] * -along_y + normals[i, 1] * along_x)
            position = x * along_x + y * along_y
            is_beside = -past <= position <= length + past
            if is_beside and abs(x * along_y - y * along_x) <= (
                across if looks >= same_way else sideways
            ):
                drawn[i] = True
                break
