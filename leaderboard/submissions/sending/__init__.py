"""The side of the sender: `oysterbench submit`."""
