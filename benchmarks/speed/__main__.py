"""``python -m benchmarks.speed``: all measurements of speed, one after another."""

from benchmarks.speed import batch_slam, ekf, env, vector


def main() -> None:
    """Print the tables of the environment, the batches of environments, the filters and the batches of beliefs."""
    _print_title("Environments")
    env.main([])
    _print_title("Batches of environments")
    vector.main([])
    _print_title("Filters")
    ekf.main()
    _print_title("Batches of beliefs")
    batch_slam.main([])


def _print_title(title: str) -> None:
    print(f"\n## {title}\n", flush=True)


if __name__ == "__main__":
    main()
