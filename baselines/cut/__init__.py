"""Translation of rendered images so that they look real: contrastive unpaired translation, and cheap controls."""
