"""Oysters in a user's own images and videos: counts, cover and sizes, with any method for images."""
