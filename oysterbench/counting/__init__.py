"""Oysters in people's own images and videos: counts, cover and sizes, with a method of images."""
