"""Submissions: tokens, intake, queue, scoring in a limited process, publication."""
