#include "surg_control/monitor/parameter_watch.hpp"

#include <sstream>

namespace surg_control {
namespace {

using XmlRpc::XmlRpcValue;

std::string text_of(XmlRpcValue& all, const std::string& key) {
  if (all.getType() != XmlRpcValue::TypeStruct || !all.hasMember(key)) return "not set";
  std::ostringstream text;
  text << "'" << all[key] << "'";
  return text.str();
}

}  // namespace

std::vector<std::string> ParameterWatch::look(XmlRpcValue now) {
  std::set<std::string> keys;
  for (XmlRpcValue* all : {&frozen_, &now}) {
    if (all->getType() != XmlRpcValue::TypeStruct) continue;
    for (const auto& entry : *all) keys.insert(entry.first);
  }
  std::set<std::string> differ;
  std::vector<std::string> fresh;
  for (const std::string& key : keys) {
    const std::string was = text_of(frozen_, key), is = text_of(now, key);
    if (was == is) continue;
    const std::string sentence =
        "parameter ~" + key + " is " + is + " now and was " + was + " at the start";
    differ.insert(sentence);
    if (said_.count(sentence) == 0) fresh.push_back(sentence);
  }
  said_ = differ;
  return fresh;
}

}  // namespace surg_control
