//! Calls of the platform's transcendental functions in a crate.
//!
//! The standard library leaves the last bits of these functions to the platform. A solve, a search or a
//! stored number that depends on them differs between machines; the crate `libm` gives the same bits on all.
//! Square roots are exact by IEEE 754, and `powi` is a fixed sequence of products.
//!
//! Items and files under `#[cfg(test)]` are skipped.

use std::path::{Path, PathBuf};

use proc_macro2::{Delimiter, Span, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{ExprMethodCall, Item, ItemMod, Macro};

use crate::strata::{Finding, attributes, is_test};
use crate::{parsed, rust_files};

/// Methods of `f64` and `f32` whose last bits depend on the platform.
const TRANSCENDENTAL: [&str; 27] = [
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "cos", "cosh", "exp", "exp2",
    "exp_m1", "gamma", "hypot", "ln", "ln_1p", "ln_gamma", "log", "log10", "log2", "powf", "sin", "sin_cos",
    "sinh", "tan", "tanh",
];

fn is_transcendental(name: &syn::Ident) -> bool {
    TRANSCENDENTAL.iter().any(|function| name == function)
}

/// Every such call below the source folder `src`, in the order of files and lines.
///
/// # Panics
///
/// If a file cannot be read or parsed.
#[must_use]
pub fn platform_calls(src: &Path) -> Vec<Finding> {
    let mut files: Vec<(PathBuf, syn::File)> =
        rust_files(src).into_iter().map(|path| (path.clone(), parsed(&path))).collect();
    let tests: Vec<PathBuf> = files.iter().flat_map(|(path, file)| test_files(path, &file.items)).collect();
    files.retain(|(path, _)| !tests.iter().any(|test| path.with_extension("").starts_with(test)));
    let mut findings = Vec::new();
    for (path, file) in &files {
        let file_name = path.strip_prefix(src).unwrap_or(path).to_path_buf();
        let mut calls = Calls { file: file_name, findings: Vec::new() };
        calls.visit_file(file);
        findings.extend(calls.findings);
    }
    findings.sort();
    findings
}

/// The files, without extension, of the modules that `file` declares for tests only.
fn test_files(file: &Path, items: &[Item]) -> Vec<PathBuf> {
    let owns_folder = file.ends_with("mod.rs") || file.ends_with("lib.rs");
    let folder = if owns_folder { file.with_file_name("") } else { file.with_extension("") };
    let declared = items.iter().filter_map(|item| match item {
        Item::Mod(ItemMod { attrs, ident, content: None, .. }) if attrs.iter().any(is_test) => Some(ident),
        _ => None,
    });
    declared.map(|ident| folder.join(ident.to_string())).collect()
}

struct Calls {
    file: PathBuf,
    findings: Vec<Finding>,
}

impl Calls {
    fn report(&mut self, name: &syn::Ident, span: Span) {
        let what = format!("{name} of the platform: use the crate libm");
        self.findings.push(Finding { file: self.file.clone(), line: span.start().line, what });
    }

    /// `.name(..)` and `f64::name` in the tokens of a macro.
    fn tokens(&mut self, tokens: TokenStream) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        for (n, token) in tokens.iter().enumerate() {
            let before = |back: usize| n.checked_sub(back).and_then(|at| tokens.get(at));
            let is_punct = |token: Option<&TokenTree>, sign: char| matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == sign);
            match token {
                TokenTree::Ident(name) if is_transcendental(name) => {
                    let called = matches!(tokens.get(n + 1), Some(TokenTree::Group(group))
                        if group.delimiter() == Delimiter::Parenthesis);
                    let of_float = is_punct(before(1), ':')
                        && matches!(before(3), Some(TokenTree::Ident(kind)) if kind != "libm");
                    if (is_punct(before(1), '.') && called) || of_float {
                        self.report(name, name.span());
                    }
                }
                TokenTree::Group(group) => self.tokens(group.stream()),
                _ => {}
            }
        }
    }
}

impl<'ast> Visit<'ast> for Calls {
    fn visit_item(&mut self, item: &'ast Item) {
        if !attributes(item).iter().any(is_test) {
            visit::visit_item(self, item);
        }
    }

    fn visit_expr_method_call(&mut self, call: &'ast ExprMethodCall) {
        if is_transcendental(&call.method) {
            self.report(&call.method, call.method.span());
        }
        visit::visit_expr_method_call(self, call);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let mut last = path.segments.iter().rev();
        if let (Some(name), Some(kind)) = (last.next(), last.next())
            && kind.ident != "libm"
            && is_transcendental(&name.ident)
        {
            self.report(&name.ident, name.ident.span());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, invoked: &'ast Macro) {
        visit::visit_macro(self, invoked);
        self.tokens(invoked.tokens.clone());
    }
}
