"""The baselines of oysterbench, each a method as anybody could write one. Found as `oysterbench_baselines`."""
