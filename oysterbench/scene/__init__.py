"""The reef: geometry, materials and motion."""
