"""OpenVINS."""
