"""Image formation: light, water and cameras; the only package with ray-casting kernels."""
