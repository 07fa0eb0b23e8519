"""Objects: from a mesh file to a prepared object and a library of them.

Import from the modules; this package stays light so that a worker starts fast.
"""
