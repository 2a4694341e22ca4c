#include "surg_control/monitor/master_probe.hpp"

#include <ros/master.h>
#include <ros/this_node.h>
#include <xmlrpcpp/XmlRpcClient.h>
#include <xmlrpcpp/XmlRpcDispatch.h>

namespace surg_control {

bool ask_master(const std::string& method, const std::string& argument, double timeout_s,
                XmlRpc::XmlRpcValue& answer) {
  XmlRpc::XmlRpcValue request, response;
  request[0] = ros::this_node::getName();
  if (!argument.empty()) request[1] = argument;
  XmlRpc::XmlRpcClient client(ros::master::getHost().c_str(),
                              static_cast<int>(ros::master::getPort()), "/");
  XmlRpc::XmlRpcDispatch dispatch;
  if (!client.executeNonBlock(method.c_str(), request)) return false;
  dispatch.addSource(&client,
                     XmlRpc::XmlRpcDispatch::WritableEvent | XmlRpc::XmlRpcDispatch::Exception);
  dispatch.work(timeout_s);
  const bool answered = client.executeCheckDone(response) && !client.isFault();
  dispatch.removeSource(&client);
  client.close();
  // [status, text, value]
  if (!answered || response.getType() != XmlRpc::XmlRpcValue::TypeArray || response.size() != 3 ||
      response[0].getType() != XmlRpc::XmlRpcValue::TypeInt || static_cast<int>(response[0]) != 1) {
    return false;
  }
  answer = response[2];
  return true;
}

}  // namespace surg_control
