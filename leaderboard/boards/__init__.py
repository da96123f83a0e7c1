"""From records to boards: ranks, the index that answers queries, and tables."""
