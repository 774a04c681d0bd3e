//! Lines of files and functions.

use std::fs;
use std::path::Path;

use syn::spanned::Spanned;
use syn::visit::{self, Visit};
use syn::{Block, ImplItemFn, Item, ItemFn, TraitItemFn};

use crate::strata::{attributes, is_test};
use crate::{parsed, rust_files};

/// The files of a folder with more than `file_lines` lines, and its functions with more than `fn_lines`,
/// except tests; one line each.
///
/// # Panics
///
/// If a file cannot be read or parsed.
#[must_use]
pub fn too_long(folder: &Path, file_lines: usize, fn_lines: usize) -> Vec<String> {
    let mut found = Vec::new();
    for file in rust_files(folder) {
        let text = fs::read_to_string(&file).unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let name = file.strip_prefix(folder).unwrap_or(&file).display().to_string();
        let lines = text.lines().count();
        if lines > file_lines {
            found.push(format!("{name}: {lines} lines"));
        }
        if file.iter().any(|part| part == "tests" || part == "tests.rs") {
            continue;
        }
        let mut functions = Functions { limit: fn_lines, found: Vec::new() };
        functions.visit_file(&parsed(&file));
        found.extend(functions.found.into_iter().map(|function| format!("{name}: {function}")));
    }
    found
}

/// Functions longer than a limit.
struct Functions {
    limit: usize,
    found: Vec<String>,
}

impl Functions {
    fn measure(&mut self, signature: &syn::Signature, block: &Block) {
        let (first, last) = (signature.span().start().line, block.span().end().line);
        let lines = last + 1 - first;
        if lines > self.limit {
            self.found.push(format!("{} has {lines} lines", signature.ident));
        }
    }
}

impl<'ast> Visit<'ast> for Functions {
    fn visit_item(&mut self, item: &'ast Item) {
        if !attributes(item).iter().any(is_test) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_fn(&mut self, function: &'ast ItemFn) {
        self.measure(&function.sig, &function.block);
        visit::visit_item_fn(self, function);
    }

    fn visit_impl_item_fn(&mut self, function: &'ast ImplItemFn) {
        self.measure(&function.sig, &function.block);
        visit::visit_impl_item_fn(self, function);
    }

    fn visit_trait_item_fn(&mut self, function: &'ast TraitItemFn) {
        if let Some(block) = &function.default {
            self.measure(&function.sig, block);
        }
        visit::visit_trait_item_fn(self, function);
    }
}
