"""Small parts that every package uses: clocks, budgets, cancellation, log output."""
