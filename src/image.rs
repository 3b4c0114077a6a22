//! Images into the network: decode, resize, normalise.
