"""Speed of the environment, the filter and the batches, beside others in the same run."""
