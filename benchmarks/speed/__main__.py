"""``python -m benchmarks.speed``: all measurements of speed, one after another."""

from benchmarks.speed import batch_slam, ekf, env, vector


def main() -> None:
    """Print the tables of the environment, the batches of environments, the filters and the batches of beliefs."""
    for title, measure in (
        ("Environments", lambda: env.main([])),
        ("Batches of environments", lambda: vector.main([])),
        ("Filters", ekf.main),
        ("Batches of beliefs", lambda: batch_slam.main([])),
    ):
        print(f"\n## {title}\n", flush=True)
        measure()


if __name__ == "__main__":
    main()
