"""An entry of the arena as a command. It needs no library, and could be written in any language.

The robot's lines come from standard input, and the answers go to standard output: the line protocol
of docs/live.md.
"""

import binascii
import sys

# mm
NEAR = 350
NOTHING_SEEN = 65535
LONGEST = 1800  # telemetry lines, after which it gives up


def say(*words: object) -> None:
    """Send a line with its checksum."""
    body = ",".join(map(str, words))
    print(f"{body}*{binascii.crc_hqx(body.encode(), 0xFFFF):04X}", flush=True)


def main() -> None:
    """Answer each line of the robot."""
    sent = 0
    for line in sys.stdin:
        letter, *fields = line.rpartition("*")[0].split(",")
        if letter == "H" and sent == 0:
            sent = 1
            say("Q", 1, sent)  # greet the robot: protocol 1
        if letter != "S":
            continue
        number = int(fields[0])
        ranges = [int(word) if word != "-" else NOTHING_SEEN for word in fields[6:]]
        sent += 1
        if number >= LONGEST:
            return  # without a stop, X, which would say that everything is explored
        is_near = min(ranges[1:5]) < NEAR
        left, right = (150, -150) if is_near else (240, 230)  # mm/s
        say("V", sent, number, left, right)


if __name__ == "__main__":
    main()
