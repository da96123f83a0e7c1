"""Shared training code: a torch Dataset of labelled images, augmentation, losses, a training loop that can be killed
and resumed."""
