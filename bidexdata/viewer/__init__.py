"""The page in the browser that shows objects and grasps."""
