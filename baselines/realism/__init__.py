"""Distance between rendered and real images, in the features of a pretrained network."""
