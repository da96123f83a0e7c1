"""What trainings share: a torch Dataset of labelled images, augmentation, losses, a loop that can be killed."""
