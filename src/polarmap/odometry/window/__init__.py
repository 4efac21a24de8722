"""The window of keyframes that are adjusted together, and their points.

residuals        photometric residuals between keyframes and their normal equations
window           the keyframes' states and images, and the prior that others left
tracing          immature points: their depth is searched in each frame
activation       immature points whose depth is known well enough become active
adjustment       Gauss-Newton over poses, brightness and depth of all that is active
marginalization  keyframes and points leave, and stay as a prior
"""
