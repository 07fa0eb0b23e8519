"""From a prepared object to two-handed grasps: regions, placement, optimisation, staging, choice."""
