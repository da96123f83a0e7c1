"""Adapters to published systems, as unmodified as they come: what obtains, builds, configures and runs each."""
