"""What buttons and gestures ask of a robot."""
