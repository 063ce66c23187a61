"""``python -m benchmarks.speed``: how fast the environments and their batches are, and the bars for that."""

from benchmarks.speed.vector import main

if __name__ == "__main__":
    main()
