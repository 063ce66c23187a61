"""Speed of the environment, the filter and the batches, compared with other software in the same run."""
