"""Hot loops on bare arrays: `reference` is the definition, `compiled` the speed; parity tests hold the two together."""
