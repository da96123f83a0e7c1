"""Experiment on what rendered images add: trainings on increasing numbers of real images, with and without rendered
ones."""
