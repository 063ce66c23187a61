"""Writes walls and paths as a drawing (DXF) for CAD programs. ezdxf is an extra, imported when it is needed."""

from pathlib import Path

from limslam_agent.output.formats.content import ExportedRun, suffix_of

_COLOURS = {"walls": 1, "true": 8, "estimated": 5, "smoothed": 4, "odometry": 30}  # AutoCAD's colour index


def write_dxf(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``map.dxf`` in metres, with a layer for the walls and one for each path.

    Raises
    ------
    ValueError
        If ezdxf is not installed.
    """
    try:
        from ezdxf import units
        from ezdxf.document import Drawing
    except ImportError as error:
        raise ValueError("a .dxf is written with ezdxf: pip install 'limslam[export]'") from error
    drawing = Drawing.new("R2010")
    drawing.units = units.M
    space = drawing.modelspace()
    drawing.layers.add("walls", color=_COLOURS["walls"])
    for x1, y1, x2, y2 in exported.run.segments.tolist():
        space.add_line((x1, y1), (x2, y2), dxfattribs={"layer": "walls"})
    for kind, each in exported.paths().items():
        for number, poses in enumerate(each):
            layer = f"path_{kind}{suffix_of(number, len(each))}"
            drawing.layers.add(layer, color=_COLOURS[kind])
            space.add_lwpolyline(poses[:, :2].tolist(), dxfattribs={"layer": layer})
    path = folder / "map.dxf"
    drawing.saveas(path)
    return [path]
