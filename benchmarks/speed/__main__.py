"""``python -m benchmarks.speed``: all measurements of speed, one after another."""

from benchmarks.speed import batch_slam, ekf, env, vector


def main() -> None:
    """Print the tables of the environments, their batches, the filters and the batches of beliefs."""
    print("## Environments\n", flush=True)
    env.main([])
    print("\n## Batches of environments\n", flush=True)
    vector.main([])
    print("\n## Filters\n", flush=True)
    ekf.main()
    print("\n## Batches of beliefs\n", flush=True)
    batch_slam.main([])


if __name__ == "__main__":
    main()
