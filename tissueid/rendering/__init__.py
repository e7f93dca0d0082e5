"""From a bundle to a force in the hand: environments, servo, sessions, recordings."""
