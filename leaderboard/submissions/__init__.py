"""Submissions: tokens, uploads, queue, scoring in a sandbox, publication."""
