"""The six-bar spherical linkage, held at one hinge by hand, let go, and watched until it rests."""
