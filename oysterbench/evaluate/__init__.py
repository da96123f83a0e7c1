"""Evaluators: estimate and truth in, result out."""
