"""What a learned policy is, of a spoofer or of a detector: contract, ONNX model and card."""
