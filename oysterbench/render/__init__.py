"""Image formation: light, water and cameras; the only home of ray-casting kernels."""
