"""Fits that learn a map from recorded signals: networks beside exact affine least squares, and the study of them."""
