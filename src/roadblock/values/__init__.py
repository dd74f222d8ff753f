"""What flows down the chart: frozen values with their checks, numpy only."""
