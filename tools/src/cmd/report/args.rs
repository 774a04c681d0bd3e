//! Arguments of the command.

use std::path::PathBuf;

use clap::Args as ClapArgs;
use palpate_core::Method;

use crate::cmd::pack;
use crate::files::Replace;

/// Measure speed and error of every method: tables, plots, one page.
///
/// Spaces, held-out solutions and blobs stay in DIR/work: after Ctrl-C run the same command to continue. The
/// page is DIR/report.html; it needs no other file and prints well. Its tables are beside it as CSV and JSON.
///
/// Without a scene the bundled organ is measured, with Mooney-Rivlin and St. Venant-Kirchhoff. One active
/// node per scene is used, with the scene's own force limit and completion of cells.
///
/// Example: palpate report --out report --grids 514,1418
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// Scene files (TOML); the bundled organ if none is given
    pub(super) scenes: Vec<PathBuf>,
    /// Folder for the page, its tables and their solutions
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Coarse grids and few held-out solutions: takes less than a minute
    #[arg(long)]
    pub(super) small: bool,
    /// Grid points of each grid; 514,1418,4168,14146 if not given
    ///
    /// They lie in the ball of radius r_G.
    #[arg(long, value_name = "N,M", value_delimiter = ',')]
    pub(super) grids: Vec<u32>,
    /// Methods, separated by commas; all if not given
    #[arg(long = "method", value_name = "M,M", value_delimiter = ',', value_parser = pack::method,
          default_values = Method::OF_LATTICE.map(Method::name), hide_default_value = true)]
    pub(super) methods: Vec<Method>,
    /// Radius r_G of the spaces, mm; each scene's own if not given
    ///
    /// 20 for the bundled organ with --small.
    #[arg(long, value_name = "MM")]
    pub(super) radius_mm: Option<f64>,
    /// Active node; each scene's first if not given
    #[arg(long, value_name = "NAME")]
    pub(super) active: Option<String>,
    /// Fit and measure all tables again, even if the blobs are there
    #[arg(long)]
    pub(super) again: bool,
    /// Worker threads; one per core if not given
    #[arg(long, value_name = "N")]
    pub(super) threads: Option<usize>,
    /// Print the table of methods as JSON
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    pub(super) replace: Replace,
}
