"""What learns: shapes of networks, their export to ONNX, and records of their training."""
