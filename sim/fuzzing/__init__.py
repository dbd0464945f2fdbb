"""The nodes that stand between the second LiDAR and the attacked topic."""
