"""The operations of a compensator: one folder per operation, with all of its forms.

A folder has the operation's float, integer, range, error, ONNX and C form; `registry` finds it, and
all other code loops over the registry. The modules beside the folders are shared by them.
"""
