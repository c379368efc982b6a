"""The figures of docs/found, computed from the published runs alone; docs/found/draw.py draws and lists them."""
