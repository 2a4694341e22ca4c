// F16: parameters are read once at the start; reports later changes, which have no effect. Pure.
#pragma once

#include <xmlrpcpp/XmlRpcValue.h>

#include <set>
#include <string>
#include <vector>

namespace surg_control {

/// Compares a node's private parameters with the copy made at the start.
class ParameterWatch {
 public:
  /// 'frozen': a struct, or anything else for none.
  explicit ParameterWatch(const XmlRpc::XmlRpcValue& frozen) : frozen_(frozen) {}

  /// One sentence for each parameter that differs in a way that has not been said yet.
  std::vector<std::string> look(XmlRpc::XmlRpcValue now);
  /// How many differ now.
  std::size_t changed() const { return said_.size(); }

 private:
  XmlRpc::XmlRpcValue frozen_;
  std::set<std::string> said_;
};

}  // namespace surg_control
