"""What a compensator is made of: one folder per operation, with all of its meanings.

A folder holds the operation's float, integer, range, error, ONNX and C meaning; `registry` finds
it, and everything else loops over that. The modules beside the folders are what they share.
"""
