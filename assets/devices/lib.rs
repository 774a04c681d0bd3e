//! The device profiles that come with Palpate, as text.
//!
//! The host reads the whole profile, precompute only its force limit. Neither may depend on the other, and
//! the core does not read TOML. The texts are therefore a separate crate.

/// Name and text of each profile.
pub const PROFILES: [(&str, &str); 15] = [
    ("delta.3", include_str!("delta.3.toml")),
    ("desktop", include_str!("desktop.toml")),
    ("dhd-falcon", include_str!("dhd-falcon.toml")),
    ("falcon", include_str!("falcon.toml")),
    ("haply", include_str!("haply.toml")),
    ("lambda.7", include_str!("lambda.7.toml")),
    ("link", include_str!("link.toml")),
    ("omega", include_str!("omega.toml")),
    ("omni", include_str!("omni.toml")),
    ("polhem", include_str!("polhem.toml")),
    ("premium-1.5", include_str!("premium-1.5.toml")),
    ("sigma.7", include_str!("sigma.7.toml")),
    ("simulated", include_str!("simulated.toml")),
    ("touch", include_str!("touch.toml")),
    ("touch-x", include_str!("touch-x.toml")),
];
