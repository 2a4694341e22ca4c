// XML as a tree of elements. expat parses, strictly: what it accepts, every parser accepts.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace surg::files {

/// One element. A name in a namespace is "URI|name".
struct Element {
  std::string name;
  int line = 0;  ///< from 1
  std::vector<std::pair<std::string, std::string>> attributes;
  std::vector<Element> children;

  /// The value of an attribute; null where there is none.
  const std::string* attribute(const std::string& wanted) const;
  /// The first child of this name; null where there is none.
  const Element* child(const std::string& wanted) const;
};

/// The text of an XML file in UTF-8; its declaration states no other encoding. Throws ConfigError
/// for bytes that are not in the encoding that the file states.
std::string read_xml_text(const std::string& path);

/// The root of an XML text. Throws ConfigError with the line for anything that is not well-formed,
/// and for a document type, which could define entities.
Element parse_xml(const std::string& text, const std::string& file);

}  // namespace surg::files
