"""What is compared: estimators by name, and what released programs do otherwise."""
