"""Baskets of regressors (eq. 5.4, Table 5.3): what they are, how they are fitted, judged and drawn."""
