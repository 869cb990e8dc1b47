"""Controllers for a fitted response: rules, optimum under margins, and the closed loop predicted before it runs."""
