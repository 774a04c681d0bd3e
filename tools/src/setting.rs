//! A value of a scene that a user sets.

use crate::failure::Failure;

/// Key and value of `KEY=VALUE`.
pub(crate) fn split(setting: &str) -> Result<(&str, &str), Failure> {
    let parts = setting.split_once('=').map(|(key, value)| (key.trim(), value.trim()));
    parts.filter(|(key, value)| !key.is_empty() && !value.is_empty()).ok_or_else(|| {
        Failure::input(format!("`{setting}` is not KEY=VALUE, for example material.c10_pa=2600"))
    })
}
