"""The model-based part of the action: reference, feed-forward torque and linear feedback."""
