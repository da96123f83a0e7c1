"""The baselines of oysterbench, each written as any outside method would be. Imported as `oysterbench_baselines`."""
