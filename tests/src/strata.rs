//! Strata inside a crate: a module imports only from its own stratum and from those below it.
//!
//! Modules are followed from `lib.rs` as the compiler does, `#[path]` attributes included. Two things are
//! imports:
//!
//! - a path that begins with `crate`, `super`, `self` or a child module: in a `use`, an expression, a type or
//!   a macro;
//! - a `#[path]` attribute: a file that belongs to another module is an import of that module. A file outside
//!   the crate is always reported: what two crates compile belongs in a crate of its own.
//!
//! Items under `#[cfg(test)]` are skipped: a test may use any module.

use std::fmt;
use std::path::{Path, PathBuf};

use proc_macro2::{Span, TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, ItemMod, ItemUse, Macro, UseTree, Visibility};

use crate::parsed;

/// One import that does not go downwards, or a module that is in no stratum.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Finding {
    /// The importing file, relative to the source folder.
    pub file: PathBuf,
    /// Line of the import.
    pub line: usize,
    /// What is wrong with it.
    pub what: String,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}: {}", self.file.display(), self.line, self.what)
    }
}

/// Every import of a crate that does not go downwards, in the order of files and lines.
///
/// `src` is the folder of `lib.rs`. `strata` are module paths without `crate`, such as `"method"` or
/// `"method::kernel"`, lowest first; a module belongs to the entry that is the longest prefix of its path.
/// `lib.rs` stands above all strata: it may import anything, and nothing may import the names it exports.
///
/// # Panics
///
/// If a file of the crate cannot be read or parsed.
#[must_use]
pub fn findings(src: &Path, strata: &[&str]) -> Vec<Finding> {
    let order: Vec<ModulePath> = strata.iter().map(|path| split(path)).collect();
    let mut findings = walk(src, &order).findings;
    findings.sort();
    findings.dedup();
    findings
}

/// What a crate's files contain.
#[derive(Default)]
pub(crate) struct Contents {
    findings: Vec<Finding>,
    /// Module of each file.
    pub(crate) files: Vec<ModulePath>,
    /// Importing module and imported path.
    pub(crate) imports: Vec<(ModulePath, ModulePath)>,
    /// Module, a name that a `use` declares in it, and the path of what it names.
    pub(crate) names: Vec<(ModulePath, String, ModulePath)>,
}

impl Contents {
    fn extend(&mut self, other: Self) {
        self.findings.extend(other.findings);
        self.files.extend(other.files);
        self.imports.extend(other.imports);
        self.names.extend(other.names);
    }
}

/// Walks a crate from the `lib.rs` in `src`.
pub(crate) fn walk(src: &Path, order: &[ModulePath]) -> Contents {
    let src = src.canonicalize().unwrap_or_else(|error| panic!("{}: {error}", src.display()));
    walk_file(&src, order, &src.join("lib.rs"), &[])
}

pub(crate) type ModulePath = Vec<String>;

fn split(path: &str) -> ModulePath {
    path.split("::").map(String::from).collect()
}

/// Visits the items of one file, and of the files that it declares.
struct Walk<'c> {
    src: &'c Path,
    order: &'c [ModulePath],
    file: &'c Path,
    /// Folder of the files that the current module declares.
    folder: PathBuf,
    module: ModulePath,
    children: Vec<String>,
    contents: Contents,
}

fn walk_file(src: &Path, order: &[ModulePath], file: &Path, module: &[String]) -> Contents {
    let parsed = parsed(file);
    let owns_folder = module.is_empty() || file.ends_with("mod.rs");
    let folder = if owns_folder { file.with_file_name("") } else { file.with_extension("") };
    let (module, children) = (module.to_vec(), declared(&parsed.items));
    let contents = Contents { files: vec![module.clone()], ..Contents::default() };
    let mut walk = Walk { src, order, file, folder, module, children, contents };
    parsed.items.iter().for_each(|item| walk.visit_item(item));
    walk.contents
}

fn declared(items: &[Item]) -> Vec<String> {
    let name = |item: &Item| if let Item::Mod(module) = item { Some(module.ident.to_string()) } else { None };
    items.iter().filter_map(name).collect()
}

impl Walk<'_> {
    /// Index of the stratum of a module or an item.
    fn rank(&self, path: &[String]) -> Option<usize> {
        let ranked = self.order.iter().enumerate().filter(|(_, prefix)| path.starts_with(prefix));
        ranked.max_by_key(|(_, prefix)| prefix.len()).map(|(rank, _)| rank)
    }

    fn report(&mut self, span: Span, what: String) {
        let file = self.file.strip_prefix(self.src).unwrap_or(self.file).to_path_buf();
        self.contents.findings.push(Finding { file, line: span.start().line, what });
    }

    /// A path in the source: an import if it begins with a module of this crate.
    fn path(&mut self, segments: &[String], span: Span) {
        if let Some(target) = self.target(segments) {
            self.import(&target, span);
        }
    }

    /// The path of an imported item from the root of the crate.
    fn target(&self, segments: &[String]) -> Option<ModulePath> {
        let [first, .., _] = segments else { return None };
        let supers = segments.iter().take_while(|segment| *segment == "super").count();
        let (mut target, skip) = match first.as_str() {
            "crate" => (Vec::new(), 1),
            "self" => (self.module.clone(), 1),
            "super" => (self.module[..self.module.len().saturating_sub(supers)].to_vec(), supers),
            child if self.children.iter().any(|name| name == child) => (self.module.clone(), 0),
            _ => return None,
        };
        target.extend_from_slice(&segments[skip..]);
        Some(target)
    }

    fn import(&mut self, target: &[String], span: Span) {
        if self.module.is_empty() {
            return;
        }
        self.contents.imports.push((self.module.clone(), target.to_vec()));
        let (module, name) = (self.module.join("::"), target.join("::"));
        match (self.rank(&self.module), self.rank(target)) {
            (Some(own), Some(other)) if other <= own => {}
            (Some(_), Some(_)) => self.report(span, format!("{module} imports crate::{name} from above it")),
            (Some(_), None) => {
                self.report(span, format!("{module} imports crate::{name}, which is in no stratum"));
            }
            // Reported at the declaration of the module.
            (None, _) => {}
        }
    }

    /// The file of a declared module: that of its `#[path]`, or the one with its name.
    fn file_of(&mut self, module: &ItemMod, child: &[String]) -> PathBuf {
        let name = module.ident.to_string();
        let Some(path) = module.attrs.iter().find_map(path_attribute) else {
            let file = self.folder.join(format!("{name}.rs"));
            return if file.exists() { file } else { self.folder.join(name).join("mod.rs") };
        };
        let file = self.file.with_file_name(path);
        let file = file.canonicalize().unwrap_or_else(|error| panic!("{}: {error}", file.display()));
        let natural = file.strip_prefix(self.src).map(module_of_file);
        match natural {
            Ok(natural) if natural.as_slice() == child => {}
            Ok(natural) => {
                let parent = std::mem::replace(&mut self.module, child.to_vec());
                self.import(&natural, module.ident.span());
                self.module = parent;
            }
            Err(_) => {
                let what = format!("{} compiles {}, outside of the crate", child.join("::"), file.display());
                self.report(module.ident.span(), what);
            }
        }
        file
    }

    fn use_tree(&mut self, tree: &UseTree, before: &[String]) {
        let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
        match tree {
            UseTree::Path(path) => self.use_tree(&path.tree, &with(&path.ident)),
            UseTree::Name(name) => self.named(&with(&name.ident), &name.ident),
            UseTree::Rename(name) => self.named(&with(&name.ident), &name.rename),
            UseTree::Glob(glob) => {
                self.path(&[before, &["*".into()]].concat(), glob.star_token.spans[0]);
            }
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.use_tree(tree, before)),
        }
    }

    /// A path that a `use` makes available as `name`.
    fn named(&mut self, segments: &[String], name: &syn::Ident) {
        self.path(segments, name.span());
        let Some(mut target) = self.target(segments) else { return };
        target.pop_if(|last| last == "self");
        let name = if name == "self" { target.last().cloned().unwrap_or_default() } else { name.to_string() };
        self.contents.names.push((self.module.clone(), name, target));
    }

    /// Paths in the tokens of a macro.
    fn tokens(&mut self, tokens: TokenStream) {
        let (mut path, mut colons, mut start) = (Vec::new(), 0, Span::call_site());
        for token in tokens {
            match &token {
                TokenTree::Ident(name) => {
                    if colons != 2 {
                        self.path(&std::mem::take(&mut path), start);
                        start = name.span();
                    }
                    path.push(name.to_string());
                    colons = 0;
                }
                TokenTree::Punct(punct) if punct.as_char() == ':' => colons += 1,
                _ => {
                    self.path(&std::mem::take(&mut path), start);
                    colons = 0;
                }
            }
            if let TokenTree::Group(group) = token {
                self.tokens(group.stream());
            }
        }
        self.path(&path, start);
    }
}

impl<'ast> Visit<'ast> for Walk<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !attributes(item).iter().any(is_test) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, module: &'ast ItemMod) {
        let name = module.ident.to_string();
        let child = [self.module.as_slice(), std::slice::from_ref(&name)].concat();
        if self.rank(&child).is_none() && !self.order.iter().any(|path| path.starts_with(&child)) {
            self.report(module.ident.span(), format!("{} is in no stratum", child.join("::")));
        }
        match &module.content {
            None => {
                let file = self.file_of(module, &child);
                let found = walk_file(self.src, self.order, &file, &child);
                self.contents.extend(found);
            }
            Some((_, items)) => {
                let outside = (self.folder.clone(), self.module.clone(), self.children.clone());
                self.folder.push(name);
                (self.module, self.children) = (child, declared(items));
                items.iter().for_each(|item| self.visit_item(item));
                (self.folder, self.module, self.children) = outside;
            }
        }
    }

    fn visit_item_use(&mut self, item: &'ast ItemUse) {
        self.use_tree(&item.tree, &[]);
    }

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let segments: Vec<String> = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        if let (None, Some(first)) = (&path.leading_colon, path.segments.first()) {
            self.path(&segments, first.ident.span());
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, invoked: &'ast Macro) {
        visit::visit_macro(self, invoked);
        self.tokens(invoked.tokens.clone());
    }

    /// `pub(in ...)` names a module and imports nothing.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}
}

pub(crate) fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(item) => &item.attrs,
        Item::Enum(item) => &item.attrs,
        Item::Fn(item) => &item.attrs,
        Item::Impl(item) => &item.attrs,
        Item::Macro(item) => &item.attrs,
        Item::Mod(item) => &item.attrs,
        Item::Static(item) => &item.attrs,
        Item::Struct(item) => &item.attrs,
        Item::Trait(item) => &item.attrs,
        Item::Type(item) => &item.attrs,
        Item::Use(item) => &item.attrs,
        _ => &[],
    }
}

pub(crate) fn is_test(attribute: &Attribute) -> bool {
    let is = |name: &str| attribute.path().is_ident(name);
    is("test") || (is("cfg") && attribute.parse_args::<syn::Ident>().is_ok_and(|of| of == "test"))
}

fn path_attribute(attribute: &Attribute) -> Option<String> {
    let value = attribute.meta.require_name_value().ok().filter(|value| value.path.is_ident("path"))?;
    match &value.value {
        syn::Expr::Lit(syn::ExprLit { lit: syn::Lit::Str(path), .. }) => Some(path.value()),
        _ => None,
    }
}

/// The module of a file, from its location in the source folder.
fn module_of_file(file: &Path) -> ModulePath {
    let file = if file.ends_with("mod.rs") { file.with_file_name("") } else { file.with_extension("") };
    file.iter().map(|part| part.to_string_lossy().into_owned()).collect()
}
