"""The data of oysterbench: what each split is, and the rigs. Found as `oysterbench_datasets`."""
