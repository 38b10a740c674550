"""Forward: the prediction of every sample, its residual and its derivatives."""
