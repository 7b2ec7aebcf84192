"""What is proven of the chip's distance from the float model, held against runs of both."""
