"""What several baselines share: inertial samples between stamps, a navigation filter, and what aids it."""
