//! Materials of drawn surfaces: kept in the geometry buffer, applied by the shader.

/// Reflectance model of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Material {
    /// Matt, for markers.
    #[default]
    Plain,
    /// Moist tissue: wrapped diffuse light and two highlights.
    Tissue,
    /// Hard and shiny, for a tool.
    Polished,
    /// Its own colour with little shading.
    Luminous,
}
