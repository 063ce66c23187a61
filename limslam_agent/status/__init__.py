"""Whether the estimate can be trusted: ``ok``, ``unsure`` or ``lost``, without ground truth."""
