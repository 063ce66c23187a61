"""An entry of the mapping track as a command: ``dead_reckoning.py log.csv OUT`` writes a trajectory and a map.

It needs no library, and could be written in any language.
"""

import csv
import json
import math
import sys
from pathlib import Path

AXLE, RADIUS, MAX_RANGE = 0.16, 0.10, 1.5  # m, of the paper's robot


def main() -> None:
    """Integrate the wheel travel, and draw a short wall in front of each tenth reading of the left beam."""
    table, out = Path(sys.argv[1]), Path(sys.argv[2])
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    x = y = heading = 0.0  # the frame is free: the arena moves the first pose onto the true one
    poses, walls = [], []
    for number, row in enumerate(rows):
        left, right = float(row["left"]), float(row["right"])
        middle = heading + 0.5 * (right - left) / AXLE
        heading += (right - left) / AXLE
        x += 0.5 * (left + right) * math.cos(middle)
        y += 0.5 * (left + right) * math.sin(middle)
        poses.append(f"{row['t']} {x} {y} 0 0 0 {math.sin(0.5 * heading)} {math.cos(0.5 * heading)}")
        if number % 10 == 0 and float(row["r_90"]) < MAX_RANGE:
            reach = RADIUS + float(row["r_90"])
            wall_x, wall_y = x - reach * math.sin(heading), y + reach * math.cos(heading)
            along_x, along_y = 0.1 * math.cos(heading), 0.1 * math.sin(heading)
            walls.append([wall_x - along_x, wall_y - along_y, wall_x + along_x, wall_y + along_y])
    (out / "trajectory.tum").write_text("\n".join(poses) + "\n")
    (out / "map.json").write_text(json.dumps({"segments": walls}))


if __name__ == "__main__":
    main()
