"""Files and pictures of a finished run."""
