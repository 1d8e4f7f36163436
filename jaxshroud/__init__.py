"""jaxshroud: rub-impact dynamics of two shrouded turbine blades, event-exact, batched and differentiable."""
